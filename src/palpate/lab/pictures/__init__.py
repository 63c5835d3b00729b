"""What the facility's cameras see: textured bodies, light, lenses and image sensors.

Purpose    : render pictures of a body at rest and under load, with the true motion of each pixel.
Takes      : a configuration, a rig, the rendered vertices at one instant or during an exposure.
Gives      : grey pictures of every camera and of boards, truth maps, rigs and rigs with calibration
             errors.
Depends on : `vision`, `records`, `geometry`; Mitsuba for the rendering.
Read first : `studio.py`, then `scene.py`, `sensor.py`, `truth_maps.py`.
"""
