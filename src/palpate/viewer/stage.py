"""The 3-D scene of one browser tab, coloured by a quantity at the points of a probing.

Lengths in the scene are in millimetres. viser puts HTML into the page unchecked: texts go through
`text_html`.
"""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, cast

import matplotlib as mpl
import numpy as np
import trimesh
from jaxtyping import Float, UInt8
from matplotlib.colors import to_hex

from palpate.figures import (
    GREY,
    HELD,
    INK,
    LENGTHS,
    MODULI,
    MOST_SIGMAS,
    ORANGE,
    PALE_BLUE,
    RESIDUALS,
    best_direction,
    half_way,
    modulus_span,
)
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    closest_points,
    surface_strain,
    unit_normals,
)
from palpate.pipeline import FittedProbing
from palpate.records import ModulusMap
from palpate.shapes import Indices, Points, PointScalars, Vector3, Vertices
from palpate.viewer.drawings import camera_picture, frames
from palpate.viewer.scenes import camera_view_pose, draw_arrows, draw_camera, light, look, rgb
from palpate.viewer.subject import Subject

# Initial view of a tab.
OBJECT = "the first probing's side"
_BODY, _SET = "#c9ccd2", "#e69f00"
_GLASS = 0.25
# Sizes as fractions of the object's: points, arrows, label distance.
_POINT, _ARROW, _NEAR = 0.009, 0.2, 0.03
# Of a point as it is drawn, over its nominal size.
_RADIUS = 1.25
# Largest number of arrows; more would hide the points.
_MAX_ARROWS = 250
MEASURED, PREDICTED, RESIDUAL, SIGMA, STRAIN, STRAIN_PREDICTED = FIELDS = (
    "displacement, measured", "displacement, predicted", "residual, in sigmas", "sigma",
    "strain, measured", "strain, predicted",
)  # fmt: skip
# Quantile of the values at the end of the scale, so that false matches do not determine it.
_TOP = 0.97
Colours = UInt8[np.ndarray, "n 3"]
# As viser sets its own texts.
_STYLE = "padding:0 .8em .7em;font-size:.875rem;white-space:pre-line;overflow-wrap:anywhere"
_STOPS = 12


@dataclass(frozen=True, slots=True, eq=False)
class ColouredField:
    """Points with one value each, for drawing.

    Attributes
    ----------
    points : (n, 3) float [m]           at rest
    displacement : (n, 3) float [m]     with which they are drawn
    values : (n,) float                 in `unit`
    top : float                         value at the end of the scale
    unit : str                          "mm", "sigmas" or "%"
    cmap : str                          colour map of matplotlib
    """

    points: Points
    displacement: Points
    values: PointScalars
    top: float
    unit: str
    cmap: str


class Stage:
    """The object, its points, forces, cameras and the ball in one tab.

    Parameters
    ----------
    client : ClientHandle of viser  the tab
    subject : Subject
    """

    def __init__(self, client: Any, subject: Subject) -> None:
        self.scene, self.subject, self._client = client.scene, subject, client
        # Controls call from several threads: hold this lock while drawing.
        self.lock = threading.RLock()
        mesh = subject.session.mesh
        self.size = 1e3 * bounding_diagonal(mesh)
        self._held = subject.session.held_triangles
        self._marked: Indices | None = None
        self._body: Any = None
        self._loose: dict[str, Any] = {}
        self._groups = {
            name: self.scene.add_frame(f"/{name}", show_axes=False)
            for name in ("points", "arrows", "probings", "cameras")
        }
        self.draw_body(np.zeros_like(mesh.vertices), None)
        light(self.scene)
        self.look_from(OBJECT)

    @property
    def views(self) -> tuple[str, ...]:
        """Names of the available views."""
        rig = self.subject.rig
        return (OBJECT,) if rig is None else (OBJECT, *(camera.name for camera in rig.cameras))

    def look_from(self, view: str) -> None:
        """Set the tab's view: from the side of the first probing, or that of a camera."""
        rig = self.subject.rig
        for camera in rig.cameras if rig is not None and view != OBJECT else ():
            if camera.name == view:
                orientation, position, fov = camera_view_pose(camera)
                with self._client.atomic():
                    self._client.camera.wxyz, self._client.camera.position = orientation, position
                    self._client.camera.fov = fov
                return
        look(self._client, self.subject.session.mesh, direction_of(self.subject))

    @property
    def body(self) -> Any:
        """Handle of the surface, which can be clicked and dragged."""
        return self._body

    def show(self, group: str, visible: bool) -> None:
        """Show or hide a group: points, arrows, probings or cameras."""
        self._groups[group].visible = visible

    def mark_support(self, triangles: Indices | None) -> None:
        """Set the triangles that are drawn as held, for a changed support; None: the session's."""
        self._marked = triangles

    def draw_body(self, displacement: Vertices, colours: Colours | None) -> None:
        """Draw the surface.

        Parameters
        ----------
        displacement : (v, 3) float [m] magnified as drawn
        colours : (v, 3) uint8 or None  None: a uniform grey
        """
        mesh = self.subject.session.mesh
        self._displacement = displacement
        glb = self._glb(1e3 * (mesh.vertices + displacement), colours)
        if self._body is None:
            self._body = self.scene.add_glb("/body", glb)
        else:
            self._body.glb_data = glb

    @property
    def shown_mesh(self) -> TriangleMesh:
        """The surface as drawn, with magnified displacement [m]."""
        mesh = self.subject.session.mesh
        return TriangleMesh(mesh.vertices + self._displacement, mesh.triangles)

    def at_rest(self, point: Vector3) -> Vector3:
        """Position at rest of a point of the drawn surface [m]."""
        closest = closest_points(self.shown_mesh, point[None])
        corners = self.subject.session.mesh.triangles[closest.triangle[0]]
        return np.asarray(point - closest.barycentric[0] @ self._displacement[corners])

    def _glb(self, vertices: Vertices, colours: Colours | None) -> bytes:
        """The surface as binary glTF, with separate corners, so that facets are shaded flat."""
        triangles = self.subject.session.mesh.triangles
        plain = np.tile(np.array(rgb(_BODY)), (len(vertices), 1))
        corner = (plain if colours is None else colours)[triangles].astype(float)
        corner[self._held if self._marked is None else self._marked] = rgb(HELD)
        if self._marked is not None:
            corner[np.setdiff1d(self._marked, self._held)] = rgb(_SET)
        return _facets(vertices[triangles], corner)

    def draw_cut(self, axis: int, at: float) -> None:
        """Draw the modulus inside the object, what lies beyond a plane cut away.

        Parameters
        ----------
        axis : int                      0, 1, 2: the plane is at right angles to x, y, z
        at : float [m]                  where the plane meets the axis
        """
        self.close()
        modulus = self.subject.modulus
        if modulus is None:
            return
        middle = modulus.nodes[modulus.tetrahedra].mean(axis=1)
        cut, element = modulus.boundary(middle[:, axis] <= at)
        colour = modulus_colours(modulus)[element].astype(float)
        corners = 1e3 * cut.vertices[cut.triangles]
        glb = _facets(corners, np.repeat(colour[:, None], 3, axis=1))
        self._body.visible = False
        self._loose["cut"] = self.scene.add_glb("/cut", glb)

    def draw_through(self) -> None:
        """Draw the object as if of glass, with where the modulus is half way from that of the rest
        to its extremes."""
        self.close()
        modulus, estimate = self.subject.modulus, self.subject.estimate
        if modulus is None:
            return
        span = np.log(modulus_span(modulus))
        for k, ratio in enumerate(half_way(modulus, estimate.field if estimate else None)):
            surface = modulus.isosurface(ratio)
            if surface is not None:
                # In the colour of the part.
                colour = mpl.colormaps[MODULI](0.5 + np.log(ratio) / span)[:3]
                self._loose[f"part {k}"] = self.scene.add_mesh_simple(
                    f"/part {k}", 1e3 * surface.vertices, surface.triangles, color=colour,
                    side="double",
                )  # fmt: skip
        self._body.visible = False
        mesh = self.subject.session.mesh
        self._loose["glass"] = self.scene.add_mesh_simple(
            "/glass", 1e3 * mesh.vertices, mesh.triangles, color=rgb(_BODY), opacity=_GLASS,
            flat_shading=True,
        )  # fmt: skip

    def close(self) -> None:
        """Draw the whole surface again."""
        self._clear("cut", "glass", "part 0", "part 1")
        self._body.visible = True

    def draw_points(self, field: ColouredField | None, magnification: float) -> None:
        """Draw the points of a probing, with displacement magnified by `magnification`."""
        self._clear("points", "arrows")
        if field is None:
            return
        colours = colours_of(field.values, field.top, field.cmap)
        mesh = self.subject.session.mesh
        # Raised by their radius, or half of each would be hidden on slopes.
        lift = _POINT * self.size * unit_normals(mesh)[closest_points(mesh, field.points).triangle]
        positions = 1e3 * (field.points + magnification * field.displacement) + _RADIUS * lift
        self._loose["points"] = self.scene.add_point_cloud(
            "/points/measured", positions, colours,
            point_size=_POINT * self.size, point_shape="circle", precision="float32",
        )  # fmt: skip
        length = 1e3 * np.linalg.norm(field.displacement, axis=1)
        shown = np.linspace(0, len(length) - 1, min(len(length), _MAX_ARROWS)).astype(int)
        longest = max(float(length.max()), 1e-9)
        arrow_vector = 1e3 * field.displacement[shown] * (0.5 * _ARROW * self.size / longest)
        start = 1e3 * field.points[shown]
        self._loose["arrows"] = draw_arrows(
            self.scene, "/arrows/moved", start, start + arrow_vector, rgb(INK), 0.5 * self.size
        )

    def draw_probings(self, probings: tuple[FittedProbing, ...], chosen: str) -> None:
        """Draw the force of every probing; the chosen one in orange, with its magnitude."""
        starts = {}
        for probing in probings:
            newtons = float(np.linalg.norm(probing.force))
            if not newtons:
                continue
            end, here = 1e3 * probing.contact, probing.name == chosen
            start = end - _ARROW * self.size * probing.force / newtons
            colour = rgb(ORANGE if here else GREY)
            name = f"/probings/{probing.name}/force"
            draw_arrows(self.scene, name, start[None], end[None], colour, self.size)
            starts[probing.name] = start, f"{probing.name}: {newtons:.3g} N" if here else ""
        for number, (text, start) in enumerate(merged_labels(starts, _NEAR * self.size)):
            self.scene.add_label(f"/probings/label {number}", text, position=tuple(start))

    def draw_cameras(self, probing: str) -> None:
        """Draw the cameras, with their pictures of a probing at rest."""
        session, rig = self.subject.session, self.subject.rig
        if rig is None:
            return
        patterns = frames(session, probing)
        for number, camera in enumerate(rig.cameras):
            seen = camera_picture(session, rig, number, patterns[0]) if patterns else None
            draw_camera(self.scene, camera, self.size, seen)

    def draw_ball(self, centre: Vector3, radius: float, force: Vector3, text: str) -> None:
        """Draw the ball that presses, its force and a label [m, N]."""
        self.clear_ball()
        middle, newtons = 1e3 * centre, float(np.linalg.norm(force))
        self._loose["ball"] = self.scene.add_icosphere(
            "/ball", radius=1e3 * radius, color=rgb(PALE_BLUE), opacity=0.45, position=tuple(middle)
        )
        if newtons:
            # The arrow ends at the ball's surface.
            end = middle - 1e3 * radius * force / newtons
            start = end - _ARROW * self.size * force / newtons
            self._loose["push"] = draw_arrows(
                self.scene, "/push", start[None], end[None], rgb(ORANGE), self.size
            )
            self._loose["newtons"] = self.scene.add_label("/newtons", text, position=tuple(start))

    def clear_ball(self) -> None:
        """Remove the ball."""
        self._clear("ball", "push", "newtons")

    def draw_marks(self, points: dict[str, Vector3]) -> None:
        """Draw contact points that are set but not written yet [m]."""
        self._clear("marks")
        if points:
            self._loose["marks"] = self.scene.add_point_cloud(
                "/marks", 1e3 * np.array(list(points.values())), rgb(_SET),
                point_size=4 * _POINT * self.size, point_shape="circle", precision="float32",
            )  # fmt: skip

    def _clear(self, *names: str) -> None:
        for name in names:
            handle = self._loose.pop(name, None)
            if handle is not None:
                handle.remove()


def merged_labels(
    starts: Mapping[str, tuple[Vector3, str]], near: float
) -> list[tuple[str, Vector3]]:
    """Labels of the probings, one for all whose arrows begin close to each other.

    Parameters
    ----------
    starts : mapping                probing's name -> (start of its arrow [mm], text of its label;
                                    empty: its name)
    near : float [mm]               distance below which starts count as the same

    Returns
    -------
    list of (str, (3,) float [mm])  text and position of each label
    """
    places: list[tuple[Vector3, list[str]]] = []
    for name, (start, _) in starts.items():
        for position, names in places:
            if np.linalg.norm(start - position) < near:
                names.append(name)
                break
        else:
            places.append((start, [name]))
    labels = []
    for position, names in places:
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        label = next((text for name in names if (text := starts[name][1])), names[0])
        labels.append((label + more, position))
    return labels


def direction_of(subject: Subject) -> Vector3:
    """Direction toward the viewer from which most points of the first probing are visible.

    Parameters
    ----------
    subject : Subject

    Returns
    -------
    (3,) float                      unit vector, object frame
    """
    session = subject.session
    normals = unit_normals(session.mesh)
    field = session.probings[0].displacement if session.probings else None
    seen = normals if field is None else normals[field.surface.triangle]
    touched = normals.mean(axis=0)
    if session.probings:
        force = session.probings[0].force
        touched = -force / max(float(np.linalg.norm(force)), 1e-300)
    return best_direction(seen, touched)


def length_colours(displacement: Vertices) -> tuple[Colours, PointScalars, float]:
    """Colours of vertices by the length of their displacement.

    Parameters
    ----------
    displacement : (v, 3) float [m]

    Returns
    -------
    colours : (v, 3) uint8
    length : (v,) float [mm]        of each displacement
    top : float [mm]                end of the colour scale
    """
    length = 1e3 * np.linalg.norm(displacement, axis=1)
    top = max(float(length.max()), 1e-6)
    return colours_of(length, top, "viridis"), length, top


def coloured_field(probing: FittedProbing, what: str) -> ColouredField | None:
    """Values of one quantity at the points of a probing.

    Parameters
    ----------
    probing : FittedProbing
    what : str                          one of `FIELDS`

    Returns
    -------
    ColouredField or None               None if it is unknown at all points
    """
    cmap, unit, seen = LENGTHS, "mm", np.isfinite(probing.displacement)
    # A component that nobody saw is drawn as none.
    displacement = np.where(seen.any(axis=1)[:, None], np.nan_to_num(probing.displacement), np.nan)
    if what in (PREDICTED, STRAIN_PREDICTED):
        displacement = probing.predicted
    values = 1e3 * np.linalg.norm(displacement, axis=1)
    if what == RESIDUAL:
        square = ((probing.displacement - probing.predicted) / probing.sigma) ** 2
        values = np.sqrt(np.where(seen, square, 0.0).sum(axis=1) / seen.sum(axis=1).clip(1))
        cmap, unit = RESIDUALS, "sigmas"
    elif what == SIGMA:
        values = 1e3 * np.sqrt(np.mean(probing.sigma**2, axis=1))
    known = np.isfinite(values) & np.isfinite(displacement).all(axis=1)
    if not known.any():
        return None
    if what in (STRAIN, STRAIN_PREDICTED):
        # The larger of the two principal strains.
        strain = surface_strain(probing.points[known], displacement[known])
        values[known], unit = 100.0 * np.abs(strain).max(axis=1), "%"
    top = MOST_SIGMAS if what == RESIDUAL else float(np.quantile(values[known], _TOP))
    return ColouredField(
        probing.points[known], displacement[known], values[known], max(top, 1e-6), unit, cmap
    )


def _facets(corners: Float[np.ndarray, "t 3 3"], colours: Float[np.ndarray, "t 3 3"]) -> bytes:
    """Triangles as binary glTF, shaded flat, their corners in mm and colours 0 to 255."""
    light = np.rint(255 * linear_light(colours.reshape(-1, 3) / 255))
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    shape = trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)
    shape.visual = trimesh.visual.ColorVisuals(shape, vertex_colors=light.astype(np.uint8))
    return cast(bytes, shape.export(file_type="glb", include_normals=True))


def modulus_colours(modulus: ModulusMap) -> Colours:
    """Colour of every element: red stiffer, blue softer, grey where the data do not determine it.

    Parameters
    ----------
    modulus : ModulusMap
    """
    share = 0.5 + 0.5 * modulus.log_modulus / np.log(modulus_span(modulus))
    colours = np.rint(255 * mpl.colormaps[MODULI](np.clip(share, 0.0, 1.0))[:, :3])
    colours[~modulus.is_known] = rgb(_BODY)
    return np.asarray(colours, dtype=np.uint8)


def colours_of(values: PointScalars, top: float, cmap: str) -> Colours:
    """RGB colours of values on a scale from zero.

    Parameters
    ----------
    values : (n,) float
    top : float                         > 0; end of the scale
    cmap : str                          colour map of matplotlib

    Returns
    -------
    (n, 3) uint8
    """
    share = np.clip(np.nan_to_num(values) / top, 0.0, 1.0)
    return np.asarray(np.rint(255 * mpl.colormaps[cmap](share)[:, :3]), dtype=np.uint8)


def linear_light(colours: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Convert sRGB colours to linear RGB, which glTF requires.

    Parameters
    ----------
    colours : (n, 3) float              0 to 1, sRGB

    Returns
    -------
    (n, 3) float                        0 to 1
    """
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def text_html(text: str, *, bold: str = "", italic: bool = False) -> str:
    """HTML that shows a text as it is: what a file has put into it is no markup.

    Parameters
    ----------
    text : str                          line breaks are kept
    bold : str                          shown in bold before it
    italic : bool                       of a text that says what is not there, or not yet

    Returns
    -------
    str
    """
    shown = (f"<b>{escape(bold)}</b>" if bold else "") + escape(text)
    return f'<div style="{_STYLE}">{f"<i>{shown}</i>" if italic else shown}</div>'


def scale_html(numbers: Sequence[str], cmap: str) -> str:
    """A colour bar with its numbers, as HTML.

    Parameters
    ----------
    numbers : sequence of str           evenly spaced below it, from left to right
    cmap : str                          colour map of matplotlib

    Returns
    -------
    str
    """
    stops = ", ".join(to_hex(c) for c in mpl.colormaps[cmap](np.linspace(0.0, 1.0, _STOPS)))
    below = "".join(f"<span>{escape(number)}</span>" for number in numbers)
    return (
        '<div style="margin:.3em 1em;font-size:.8em">'
        '<div style="height:.9em;border:1px solid #888;'
        f'background:linear-gradient(to right,{stops})">'
        '</div><div style="display:flex;justify-content:space-between">'
        f"{below}</div></div>"
    )
