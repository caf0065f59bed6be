"""Training images of a world: real textures, meshes and lights beside procedural ones, made while a network trains."""
