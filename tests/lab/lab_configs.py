"""Small configurations of the facility: pictures of a thumbnail's size."""

HALF_BALL = """\
format = "palpate-lab/1"
name = "small half ball"
seed = 3
[specimen]
shape = "half-ball"
radius = 0.04
edge = 0.008
element = 0.01
[material]
young_modulus = 52e3
poisson_ratio = 0.21
[look]
size = 4e-3
[arm]
radius = 6e-3
misalignment = 2.0
[force_sensor]
noise = 0.002
[position_sensor]
noise = 5e-5
[head]
distance = 0.5
columns = 200
rows = 160
[pictures]
samples = 8
[[probe]]
name = "n01"
point = [0, 0, 0.04]
depth = 4e-3
steps = 2
"""

STAGE = """\
format = "palpate-lab/1"
name = "small toy"
[specimen]
shape = "toy"
radius = 0.03
edge = 0.008
[material]
young_modulus = 1e5
poisson_ratio = 0.3
[look]
texture = "natural"
size = 3e-3
[stage]
steps = 2
translation = [1e-3, 0, 0]
rotation = 3.0
[head]
distance = 0.5
columns = 200
rows = 160
"""
