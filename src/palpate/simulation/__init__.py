"""An estimate at work: poked in real time, and handed to simulators.

Purpose    : forces and displacements of an object under tools, at haptic rates.
Takes      : a `Session`, an `Estimate`; tools with their poses.
Gives      : `GreenFunctions` and their files, `ContactState`; folders for simulators.
Depends on : `pipeline`, `field`, `solids`, `bem`, `probe`, `contact`, `records`, `geometry`.
Read first : `green_functions.py`, `contact.py`; `export.py`, then `estimated_object.py`.
"""

from palpate.simulation.contact import (
    force_covariance as force_covariance,
    start_contact as start_contact,
    surface_displacement as surface_displacement,
    touch as touch,
)
from palpate.simulation.estimated_object import (
    Material as Material,
    estimated_material as estimated_material,
    exact_material as exact_material,
)
from palpate.simulation.export import (
    FORMATS as FORMATS,
    FitSource as FitSource,
    export_fit as export_fit,
    read_fit as read_fit,
    read_fitted as read_fitted,
)
from palpate.simulation.green_functions import (
    GreenFunctions as GreenFunctions,
    make_green_functions as make_green_functions,
    nearest_nodes as nearest_nodes,
    read_green_functions as read_green_functions,
    write_green_functions as write_green_functions,
)
