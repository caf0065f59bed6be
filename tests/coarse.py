"""The protocol of runs whose scores are coarse and take little time."""

COARSE = ("protocol.map_points=2", "protocol.render_points=2", "protocol.samples_per_pixel=8")
