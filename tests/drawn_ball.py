"""A STEP file of a ball: its text, as short as readers take it."""

from pathlib import Path

# A ball of radius 30 about (10, 0, 0) and nothing else, as drawing programs write it.
_BALL = """\
ISO-10303-21;
HEADER;
FILE_DESCRIPTION((''),'2;1');
FILE_NAME('ball','2026-11-22T00:00:00',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));
ENDSEC;
DATA;
#1=APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,#2);
#2=APPLICATION_CONTEXT('core data for automotive mechanical design processes');
#3=SHAPE_DEFINITION_REPRESENTATION(#4,#10);
#4=PRODUCT_DEFINITION_SHAPE('','',#5);
#5=PRODUCT_DEFINITION('design','',#6,#9);
#6=PRODUCT_DEFINITION_FORMATION('','',#7);
#7=PRODUCT('ball','ball','',(#8));
#8=PRODUCT_CONTEXT('',#2,'mechanical');
#9=PRODUCT_DEFINITION_CONTEXT('part definition',#2,'design');
#10=ADVANCED_BREP_SHAPE_REPRESENTATION('',(#15),#27);
#15=MANIFOLD_SOLID_BREP('',#16);
#16=CLOSED_SHELL('',(#17));
#17=ADVANCED_FACE('',(#18),#22,.T.);
#18=FACE_BOUND('',#19,.T.);
#19=VERTEX_LOOP('',#20);
#20=VERTEX_POINT('',#21);
#21=CARTESIAN_POINT('',(10.,0.,-30.));
#22=SPHERICAL_SURFACE('',#23,30.);
#23=AXIS2_PLACEMENT_3D('',#24,#25,#26);
#24=CARTESIAN_POINT('',(10.,0.,0.));
#25=DIRECTION('',(0.,0.,1.));
#26=DIRECTION('',(1.,0.,0.));
#27=(GEOMETRIC_REPRESENTATION_CONTEXT(3) GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#31))
GLOBAL_UNIT_ASSIGNED_CONTEXT((#28,#29,#30)) REPRESENTATION_CONTEXT('',''));
#29=(NAMED_UNIT(*) PLANE_ANGLE_UNIT() SI_UNIT($,.RADIAN.));
#30=(NAMED_UNIT(*) SI_UNIT($,.STERADIAN.) SOLID_ANGLE_UNIT());
#31=UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-07),#28,'distance_accuracy_value','');
#28=UNIT
ENDSEC;
END-ISO-10303-21;
"""
MILLIMETRE = "(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.));"
INCH = f"""\
(CONVERSION_BASED_UNIT('INCH',#33) LENGTH_UNIT() NAMED_UNIT(#34));
#33=LENGTH_MEASURE_WITH_UNIT(25.4,#35);
#34=DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);
#35={MILLIMETRE}"""


def written_ball(folder: Path, unit: str) -> Path:
    """Write ball.step in a unit."""
    file = folder / "ball.step"
    file.write_text(_BALL.replace("UNIT\nENDSEC", f"{unit}\nENDSEC"))
    return file
