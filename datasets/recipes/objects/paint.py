"""Materials written as expressions: `Paint` adds one shader node per call and joins them to one Principled BSDF.

Every object keeps an identity transform, so that Object texture coordinates stay the same after joining.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence

import bpy

# isort: split
from mathutils import Matrix  # can be imported only after bpy

Socket = bpy.types.NodeSocket
Value = Socket | float | Sequence[float]


class Paint:
    """Material with one Principled BSDF whose inputs are built from expressions of node sockets.

    Methods add one node each and return its output socket; `finish` connects base colour and roughness.
    Arguments named `Value` take a socket, a number, or a linear RGB / vector triple.
    """

    def __init__(self, name: str) -> None:
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.nodes = self.material.node_tree.nodes
        self.links = self.material.node_tree.links
        self.nodes.clear()

    def _set(self, socket: Socket, value: Value) -> None:
        if isinstance(value, bpy.types.NodeSocket):
            self.links.new(value, socket)
        elif socket.type == "RGBA":
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value

    def position(self) -> Socket:
        """Object coordinates (world coordinates, as transforms are identities)."""
        return self.nodes.new("ShaderNodeTexCoord").outputs["Object"]

    def local(self, matrix: Matrix) -> Socket:
        """Position in the frame of `matrix` (a rotation and a translation)."""
        node = self.nodes.new("ShaderNodeMapping")
        node.vector_type = "TEXTURE"  # applies the inverse
        self._set(node.inputs["Vector"], self.position())
        node.inputs["Location"].default_value = matrix.to_translation()
        node.inputs["Rotation"].default_value = matrix.to_euler()
        return node.outputs["Vector"]

    def attribute(self, name: str) -> Socket:
        """Vector attribute of the mesh."""
        node = self.nodes.new("ShaderNodeAttribute")
        node.attribute_name = name
        return node.outputs["Vector"]

    def split(self, vector: Socket) -> tuple[Socket, Socket, Socket]:
        """Components of a vector."""
        node = self.nodes.new("ShaderNodeSeparateXYZ")
        self._set(node.inputs[0], vector)
        return node.outputs[0], node.outputs[1], node.outputs[2]

    def join(self, x: Value, y: Value, z: Value) -> Socket:
        """Vector from components."""
        node = self.nodes.new("ShaderNodeCombineXYZ")
        for socket, value in zip(node.inputs, (x, y, z), strict=True):
            self._set(socket, value)
        return node.outputs[0]

    def math(self, operation: str, *values: Value) -> Socket:
        """Scalar operation of Blender's Math node, such as 'ADD' or 'MULTIPLY'."""
        node = self.nodes.new("ShaderNodeMath")
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            self._set(socket, value)
        return node.outputs[0]

    def formula(self, text: str, **names: Value) -> Socket:
        """Math nodes from a Python expression of + - * /, numbers, `names`, and Math operations in lower case.

        For example ``formula("absolute(v - 0.5) * 2", v=across)``.
        """
        operators = {ast.Add: "ADD", ast.Sub: "SUBTRACT", ast.Mult: "MULTIPLY", ast.Div: "DIVIDE"}

        def visit(node: ast.expr) -> Value:
            if isinstance(node, ast.BinOp) and type(node.op) in operators:
                return self.math(operators[type(node.op)], visit(node.left), visit(node.right))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                return self.math(node.func.id.upper(), *(visit(argument) for argument in node.args))
            if isinstance(node, ast.Name):
                return names[node.id]
            if isinstance(node, ast.Constant):
                return node.value
            raise ValueError(f"formula {text!r}: expected + - * /, calls, names or numbers, found {ast.dump(node)}")

        return visit(ast.parse(text, mode="eval").body)

    def vector(self, operation: str, *values: Value) -> Socket:
        """Operation of the Vector Math node; 'LENGTH', 'DISTANCE' and 'DOT_PRODUCT' return a scalar."""
        node = self.nodes.new("ShaderNodeVectorMath")
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            self._set(socket, value)
        return node.outputs["Value" if operation in ("LENGTH", "DISTANCE", "DOT_PRODUCT") else "Vector"]

    def smooth(self, value: Value, start: float, end: float, low: Value = 0.0, high: Value = 1.0) -> Socket:
        """`low` where value is at `start`, `high` where it is at `end`, a smoothstep between (start < end)."""
        node = self.nodes.new("ShaderNodeMapRange")
        node.interpolation_type = "SMOOTHSTEP"
        for socket, item in zip(node.inputs, (value, start, end, low, high), strict=False):
            self._set(socket, item)
        return node.outputs[0]

    def between(self, value: Value, low: float, high: float, soft: float = 0.003) -> Socket:
        """1 where value lies in [low, high], 0 elsewhere; either edge is a smoothstep over low or high +- `soft`."""
        rising = self.smooth(value, low - soft, low + soft)
        return self.math("MULTIPLY", rising, self.smooth(value, high - soft, high + soft, 1.0, 0.0))

    def noise(self, coordinates: Socket, scale: float, detail: float = 3.0) -> Socket:
        """Fractal noise, about 0.5 on average."""
        node = self.nodes.new("ShaderNodeTexNoise")
        self._set(node.inputs["Vector"], coordinates)
        node.inputs["Scale"].default_value = scale
        node.inputs["Detail"].default_value = detail
        return node.outputs["Fac"]

    def random(self, coordinates: Socket) -> Socket:
        """Uniform hash of a vector in [0, 1), for a value per plank, panel or tile."""
        node = self.nodes.new("ShaderNodeTexWhiteNoise")
        self._set(node.inputs["Vector"], coordinates)
        return node.outputs["Value"]

    def voronoi(self, coordinates: Socket, scale: float, flat: bool = False) -> dict[str, Socket]:
        """Nearest Voronoi cell: 'Distance' and 'Position' in units of `coordinates`, random 'Color' of the cell.

        `flat` ignores the third coordinate.
        """
        node = self.nodes.new("ShaderNodeTexVoronoi")
        node.voronoi_dimensions = "2D" if flat else "3D"
        self._set(node.inputs["Vector"], coordinates)
        node.inputs["Scale"].default_value = scale
        return {
            "Distance": self.math("DIVIDE", node.outputs["Distance"], scale),
            "Position": node.outputs["Position"],
            "Color": node.outputs["Color"],
        }

    def mix(self, factor: Value, first: Value, second: Value) -> Socket:
        """Colour `first` at factor 0, `second` at factor 1 (linear RGB)."""
        node = self.nodes.new("ShaderNodeMix")
        node.data_type = "RGBA"
        self._set(node.inputs["Factor"], factor)
        colours = [socket for socket in node.inputs if socket.type == "RGBA"]
        self._set(colours[0], first)
        self._set(colours[1], second)
        return next(socket for socket in node.outputs if socket.type == "RGBA")

    def blend(self, factor: Value, first: Value, second: Value) -> Socket:
        """Number `first` at factor 0, `second` at factor 1."""
        node = self.nodes.new("ShaderNodeMix")
        for socket, value in zip(node.inputs, (factor, None, first, second), strict=False):
            if value is not None:  # inputs: float factor, vector factor, float A, float B
                self._set(socket, value)
        return node.outputs[0]

    def finish(self, base_color: Value, roughness: Value) -> bpy.types.Material:
        """Connect the two inputs of a dielectric Principled BSDF and return the material."""
        principled = self.nodes.new("ShaderNodeBsdfPrincipled")
        output = self.nodes.new("ShaderNodeOutputMaterial")
        self._set(principled.inputs["Base Color"], base_color)
        self._set(principled.inputs["Roughness"], roughness)
        self.links.new(principled.outputs[0], output.inputs["Surface"])
        return self.material
