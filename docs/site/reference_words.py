"""What the pages of the reference say where no docstring does: tables, a line each."""

# What no docstring of a record says: by table and key, or by key.
WORDS = {
    "format": 'always `"palpate-session/1"`',
    ("the file itself", "name"): "of the session; by default that of its folder",
    ("the file itself", "object"): "table `[object]`",
    "support": "table `[support]`: what is held",
    "gravity": "table `[gravity]`, only where gravity acts in the loaded state alone",
    "rig": "table `[rig]`, where there are pictures",
    "errors": "table `[errors]`: how well shared things are known; each key has a default",
    "probe": "tables `[[probe]]`, one for each push",
    "step": "tables `[[step]]`, in place of probes: a rigid motion, pictures only",
    "mesh": "file of the closed surface: PLY, OBJ, STL, OFF, MSH, VTU or VTP",
    "length_unit": "unit of every length of the file",
    "motion": "`fixed` (default); `given`, measured in every probe; `free`, estimated along with the"
    " constants for every probe",
    "directions": "of a roller: only these are held, along the others the surface slides; by default all",
    "stiffness": "of springs between the surface and what holds it: traction over displacement; by default"
    " rigid",
    "radius": "of the patch, in the file's unit; none with profile `vertex`",
    "density": "needed with gravity; exports write 1000 if absent [kg/m^3]",
    ("[support], or several [[support]]", "plane"): "triangles whose vertices all lie near a plane",
    ("[support], or several [[support]]", "box"): "triangles whose vertices all lie within a box",
    "triangles": "numbers of triangles, one a line, from 0; `#` starts a comment",
    "region": "tables `[[region]]`: parts with a modulus of their own; `name` and one of `surface`,"
    " `box`, `plane`, `skin`",
    ("[[region]], a part with a modulus of its own", "name"): "of the region, in tables",
    ("[[region]], a part with a modulus of its own", "surface"): "closed surface around it, in the"
    " session's unit; what of it lies in the object",
    ("[[region]], a part with a modulus of its own", "box"): "everything in a box, `min` and `max`",
    ("[[region]], a part with a modulus of its own", "plane"): "everything on the side of a plane to"
    " which its normal points",
    ("[[region]], a part with a modulus of its own", "thickness"): "how far behind the plane it"
    " reaches: a layer; by default to the end",
    "skin": "everything closer to the surface than this; by default to all of it that is not held",
    "faces": "the part of the surface that has the skin: `plane`, `box` or `triangles`, as for a"
    " support",
    "young_modulus": "Young's modulus, where it is known; give none of the three to have it estimated",
    "young_modulus_std": "1 sigma; by default exact",
    "shear_modulus": "shear modulus, where it is known",
    "shear_modulus_std": "1 sigma; by default exact",
    "ratio": "modulus over that of the rest, where it is known",
    "ratio_std": "1 sigma; by default exact",
    ("plane of a region", "point"): "any point of the plane",
    "traction": 'always `"uniform"`: the same over the face',
    ("plane of a support: one table, or a list", "point"): "any point of the plane",
    "normal": "of the plane, of any length",
    "tolerance": "largest distance of a vertex from the plane",
    "min": "lowest corner", "max": "highest corner",
    ("[[step]], of a rigid-motion sequence", "images"): "its pictures, with `{camera}` in place of the"
    " camera's name",
    "rest": "pictures before the push, with `{camera}` in place of the camera's name",
    "loaded": "pictures under the push, in time; the last one is at the full force",
    "acceleration": "its direction and size [m/s^2]; acts under the push alone, unless `at_rest`",
    "at_rest": "it acted before the push, too, and the mesh is the shape without weight; counts with"
    " `--strain finite` alone",
    "cameras": "a rig.toml, or the calibration of another program",
    "pose": "of the mesh against the measured points",
    ("pose of [errors]", "translation"): "shift along each axis, 1 sigma",
    ("pose of [errors]", "rotation"): "turn about each axis, 1 sigma",
    "load": "tables `[[probe.load]]`: known loads beside the push",
    "loads": "known loads beside the push",
    "force_sensor": "name of what measured the force, where a session has several sensors or weights: each has"
    " a gain of its own in `[errors]`",
    "tip_displacement_offset_std": "how well the arm saw where it first touched, 1 sigma",
    "point_std": "how well the point is known, along each tangent, 1 sigma; by default `contact_point` of"
    " `[errors]`",
    "tool": "what presses; the touched patch follows from force and constants",
    "tool_radius": "of the sphere, of the flat face of a punch (`flat`) or of a `cylinder`, or of the"
    " base of the cone",
    "tool_mesh": "closed convex surface in the `length_unit`; the origin of its frame is the tool's centre"
    " point, which `point` places on the object",
    "tool_rotation": "rotation vector from the mesh's frame to the object's [rad]; by default the shortest one by"
    " which the tool presses along its -z axis",
    "tool_inner_radius": "of a ring, the flat end of a tube, and only there",
    "tool_angle": "of a cone, and only there: between its axis and its side",
    ("contact of a probe: a grip", "support"): "number of the support that is pulled, from 1",
    "contact": "where it presses: a table, below",
    "force": "on the object [N]",
    ("[errors]", "force"): "of a force without `force_std`, as a share of its length",
    "series": "CSV file of force and motion over time: [its columns](#series-csv)",
    "measured_at": "time of the series at which the probing's own displacement was measured; by default"
    " its last instant",
    "displacement": "CSV file of what was measured: [its columns](#displacement-csv)",
    "support_displacement": "CSV file of what was measured on the supports that move",
    "support_motion": "the motion of the support, where it is known",
    "images": "pictures that the displacement is to come from: a table, below",
    "K": "matrix of the camera, by rows [px]", "R": "rotation, by rows", "t": "translation",
    "T": "rotation and translation as one 4 x 4 matrix, in place of `R` and `t`",
    ("the file itself", "camera"): "tables `[[camera]]`, two or more",
    "reference": "name of the reference camera; by default the first",
    "size": "columns and rows of its pictures [px]",
    "profile": "how the pressure falls off", "friction": "the surface slides under it freely (default), or"
    " sticks to it",
    ("support_motion of a probe", "translation"): "shift of the support",
    ("support_motion of a probe", "rotation"): "rotation vector about the middle of the support [rad]",
}  # fmt: skip
# What the readers of `TomlTable` take.
READS = {
    "boolean": "true or false",
    "choice": "one of",
    "count": "whole number, 0 or more",
    "existing_file": "file",
    "number": "number",
    "number_or_vector": "number, or three numbers",
    "quantity": "number, or text with its unit",
    "table": "table",
    "tables": "tables",
    "text": "text",
    "label": "text of one line",
    "texts": "list of texts",
    "vector": "three numbers",
}
_LENGTH = "number, or text with its unit (`um`, `mm`, `cm`, `m`, `in`)"
_MODULUS = "number, or text with its unit (`Pa`, `kPa`, `MPa`, `GPa`, `psi`, `N/mm^2`)"
# Forms that are read by hand, not by one of the readers of `TomlTable`.
FORMS = {
    ("[errors]", "force"): "share", ("[[step]], of a rigid-motion sequence", "images"): "file pattern",
    "reference": "name of a camera",
    "pose": "table", "directions": "list of vectors", "plane": "table, or list of tables", "box": "table, or list of tables",
    "loaded": "list of file patterns", "rest": "file pattern", "images": "table; file pattern in a step",
    "support": "table", "K": "3 x 3 numbers", "R": "3 x 3 numbers", "t": "three numbers",
    "T": "4 x 4 numbers", "size": "two whole numbers", "distortion": "up to 8 numbers",
    "force_gain": "share, or a table by `force_sensor`", "contact_radius": "share",
    "touched_radius": "share", "length_scale": "share", "acceleration": "three numbers", "cameras": "file",
    "contact": "table", "errors": "table", "triangles": "text file", "probe": "tables", "step": "tables", "object": "table", "gravity": "table",
    "rig": "table", "camera": "tables", "format": "text", "name": "text",
    "length_unit": "text", "series": "file",
    "measured_at": "number, or text with its unit (`s`, `ms`)",
    "region": "tables", "ratio": "number", "ratio_std": "number", "faces": "table",
    ("[[region]], a part with a modulus of its own", "plane"): "table",
    ("[[region]], a part with a modulus of its own", "box"): "table",
    ("[[region]], a part with a modulus of its own", "thickness"): _LENGTH,
    "skin": _LENGTH, **dict.fromkeys(
        ("young_modulus", "young_modulus_std", "shear_modulus", "shear_modulus_std"), _MODULUS
    ),
}  # fmt: skip

# Columns of a displacement file.
COLUMNS = {
    "x, y, z": "an observed place of the surface at rest, in the session's `length_unit`",
    "ux, uy, uz": "its displacement, the same unit; empty or `nan`: looked at and not measured",
    "sx, sy, sz": "optional: 1 sigma of each component",
    "sigma": "optional, in their place: 1 sigma of all three",
    "vertex": "optional: the vertex of the mesh that this place is, from 0",
}

# Columns of a series.
SERIES = {
    "t": "time, increasing, from before the contact, in s; each heading may name another unit: `t [ms]`",
    "fx, fy, fz": "force on the object at that instant, in N",
    "tx, ty, tz": "optional: displacement of the contact point, in the session's `length_unit`",
    "displacement": "optional: name of a file of that instant with the points of the probing's own; empty"
    " where none was taken",
}
