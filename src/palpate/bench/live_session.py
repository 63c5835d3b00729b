"""A session that grows push by push: whole on disk after each, and fitted.

Pictures come first, then session.toml, which names them, in one step: whenever the process ends,
the folder holds a session of all pushes but the one in hand.
"""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from jaxtyping import Float
from scipy.spatial import cKDTree

from palpate.bench.pushing import PushError, TakenPush, write_picture
from palpate.bench.questions import Pictures
from palpate.checkpoints import Cache, Memory
from palpate.disk import atomic_replacement, write_bytes
from palpate.errors import InputError, RecordError
from palpate.geometry import TriangleMesh, bounding_diagonal
from palpate.pipeline import (
    FittedBody,
    Material,
    NextProbings,
    ProbingMotion,
    fit_session,
    fitted_body,
    measure_pictures,
    plan_next,
    rigid_modes,
    survey_cameras,
    survey_probing,
    survey_view,
    with_motions,
)
from palpate.progress import Progress, silent
from palpate.recording import ContactModel, find_contact, make_contact_model
from palpate.records import (
    FILE_LENGTH_UNITS,
    LENGTH_UNITS,
    SESSION_FORMAT,
    HeldObject,
    Rig,
    Session,
    Step,
    TomlTable,
    read_object_mesh,
    read_rig,
    read_session,
    read_supports,
    read_toml,
)
from palpate.shapes import Points, Vector3
from palpate.vision import JointFlow, is_valid, picture_path, read_pictures

_IMAGES, _REST, _LOADED = "images", "images/{}_rest_{{camera}}.png", "images/{}_{{camera}}.png"
_LOOKS = tuple(Step(name, f"{_IMAGES}/{name}_{{camera}}.png") for name in ("look1", "look2"))
# Half the vectors of a push are below so many standard deviations: it was too light.
_CLEAR = 3.0
# Share of the surface that pictures at rest must let follow.
_FOLLOWED = 0.8
# An object that has moved by more than this share of its size since the first push, and by more
# than so many standard deviations, has been moved.
_MOVED, _SURE = 2e-3, 5.0
# An object slid that stands elsewhere after a push than before it by more than this share of what
# then goes back (rms): up to the same share of its modulus would be wrong. Spacing of the points in
# which that is seen [px].
_SLID, _STEP = 0.05, 9
# What is still deformed by more of the push, a moment after it, is still pressed.
_STILL_PRESSED = 0.5
# Standard deviation of a push's direction about each axis [rad]: 3 degrees, and 1 degree.
_TURNED_BY_HAND, _TURNED_BY_ARM = 0.05, 0.017
# Pushes that are planned ahead, to say how many more are needed.
_AHEAD = 6
# Contact radius assumed where the contact is searched for, over the tool's.
_TOUCHED = 0.5


class LiveSession:
    """A session's folder while it is measured.

    Parameters
    ----------
    folder : Path                   made if missing; a session that is in it is gone on with
    head : dict                     tables object, support, rig, ... of session.toml
    contact : dict                  keys of every probing's contact, but the point
    by_hand : bool                  the point is where the surface shows it, not where it was asked
    cache : Path or None            where what is computed of the body is kept; None: in memory

    Raises
    ------
    RecordError                     another session is there; invalid tables
    """

    def __init__(
        self, folder: Path, head: dict[str, Any], contact: dict[str, Any], *, by_hand: bool,
        cache: Path | None = None,
    ) -> None:  # fmt: skip
        self.folder, self.contact, self.by_hand = folder, contact, by_hand
        self.content: dict[str, Any] = {"format": SESSION_FORMAT, **head, "probe": []}
        self._motions: dict[str, ProbingMotion] = {}
        self._cache: Cache = Memory() if cache is None else cache
        self._plan: NextProbings | None = None
        self._model: ContactModel | None = None
        self._first: tuple[Any, JointFlow] | None = None
        # A push after which no pictures were taken yet.
        self._open: TakenPush | None = None
        (folder / _IMAGES).mkdir(exist_ok=True)
        if (folder / "session.toml").exists():
            self._go_on()
        root = TomlTable(folder / "session.toml", "", self.content)
        body = root.table("object")
        self.metres = FILE_LENGTH_UNITS[body.choice("length_unit", tuple(FILE_LENGTH_UNITS))]
        self.mesh: TriangleMesh = read_object_mesh(body, self.metres)[0]
        supports = read_supports(root, self.mesh, metres_per_unit=self.metres)
        held = HeldObject(self.mesh, supports, self.metres)
        self.rig: Rig = read_rig(root.table("rig").existing_file("cameras"))
        self.bare = Session(
            str(head.get("name", folder.name)), root.file, self.mesh, held.held_triangles(), (),
            None, None, root.table("rig").existing_file("cameras"), (), supports=supports,
            steps=_LOOKS, metres_per_unit=self.metres,
        )  # fmt: skip
        self._check()

    @property
    def file(self) -> Path:
        """Path of session.toml."""
        return self.folder / "session.toml"

    @property
    def count(self) -> int:
        """Number of pushes so far."""
        return len(self.content["probe"])

    def _check(self) -> None:
        """Refuse tables that would be refused with the first push, by reading a push where the
        object is farthest from what is held."""
        mesh, held = self.mesh, np.unique(self.mesh.triangles[self.bare.held_triangles])
        gap = cKDTree(mesh.vertices[held]).query(mesh.vertices)[0]
        point = mesh.vertices[gap.argmax()]
        force = mesh.vertices[held].mean(axis=0) - point
        probe = {
            "name": "push", "contact": {**self.contact, "point": (point / self.metres).tolist()},
            "force": force.tolist(), "tip_displacement": (1e-3 * force / self.metres).tolist(),
        }  # fmt: skip
        if "point" in self.contact:
            raise InputError("bench.toml: [contact] point: leave it out; it differs between pushes")
        content = self.content | {"probe": [probe]}
        try:
            # As it would be read from a file.
            values = tomlkit.parse(tomlkit.dumps(content)).unwrap()
        except ValueError as error:
            # What is no value of a table, such as None.
            raise InputError(f"bench.toml: {error}") from error
        read_session(TomlTable(self.folder / "bench.toml", "", values))

    def look(self, *pictures: Pictures) -> tuple[tuple[str, ...], bool]:
        """What two pictures at rest, one after the other, show, in sentences; and whether that will
        do: nothing is wrong with a camera's pictures, and most of the surface can be followed.

        Raises
        ------
        InputError                  pictures that cannot be used: black, of another size than the
                                    rig's, the same twice
        """
        files = [look.images for look in _LOOKS]
        try:
            for file, views in zip(files, pictures, strict=True):
                self._write(file, views)
            wrong = survey_cameras(self.bare)[1]
            view, remarks = survey_view(self.bare)
            seen = view is not None and view.followed >= _FOLLOWED * view.points
            return (*wrong, *remarks), seen and not wrong
        finally:
            for camera, file in product(self.rig.cameras, files):
                picture_path(camera, file, self.folder).unlink(missing_ok=True)

    def moved(self, pictures: Pictures) -> float:
        """How far the object has moved since before the first push [m]; 0 where that is no more
        than can be seen."""
        grey = _grey(pictures)
        if self._first is None:
            method, first = JointFlow(), grey
            if self.count:
                rest = self.content["probe"][0]["images"]["rest"]
                first = read_pictures(self.rig, rest, folder=self.folder, what="push 1").grey
            self._first = method.start(self.rig, first, self.mesh), method
            if not self.count:
                return 0.0
        state, method = self._first
        _, flow = method.follow(state, grey)
        valid = is_valid(flow)
        if not valid.any():
            return float("inf")
        moved = float(np.median(np.linalg.norm(flow.displacement[valid], axis=1)))
        sigma = float(np.sqrt(np.median(np.trace(flow.covariance[valid], axis1=1, axis2=2))))
        limit = max(_MOVED * bounding_diagonal(self.mesh), _SURE * sigma)
        return moved if moved > limit else 0.0

    def add(self, taken: TakenPush, point: Vector3, inward: Vector3) -> Session:
        """Add a push: judge it, then write it.

        Parameters
        ----------
        taken : TakenPush
        point : (3,) float [m]      where it was asked for
        inward : (3,) float [-]

        Returns
        -------
        Session                     of all pushes, with their displacements

        Raises
        ------
        PushError                   too light, nothing can be followed, the object slid; nothing
                                    was added
        """
        name = f"n{self.count + 1:02d}"
        self._write(_REST.format(name), taken.rest)
        self._write(_LOADED.format(name), taken.loaded)
        probe = {
            "name": name,
            "contact": {"point": (point / self.metres).tolist(), **self.contact},
            "force": (taken.force * inward).tolist(),
            "force_std": self._force_std(taken, inward),
            "images": {"rest": _REST.format(name), "loaded": [_LOADED.format(name)]},
        }
        content = self.content | {"probe": [*self.content["probe"], probe]}
        if taken.after is not None:
            self._check_place(taken, taken.after)
        with atomic_replacement(self.file) as staged:
            staged.write_text(tomlkit.dumps(content), encoding="utf-8")
            motions = self._measured(read_session(staged), name)
            if self.by_hand:
                probe["contact"] |= self._found_contact(motions[name], taken.force * inward)
                staged.write_text(tomlkit.dumps(content), encoding="utf-8")
                read_session(staged)
        self.content, self._motions = content, motions
        self._open = taken if taken.after is None else None
        return self.measured()

    def slid_since(self, rest: Pictures) -> float:
        """How far the object slid under the last push [m], by the pictures at rest before the next
        one; 0 where it did not, or where that was seen when it was added."""
        return 0.0 if self._open is None else self._remains(self._open, rest)[0]

    def withdraw(self) -> None:
        """Take the last push out again."""
        *probes, last = self.content["probe"]
        self.content = self.content | {"probe": probes}
        # The next one will have its name.
        self._motions = {k: v for k, v in self._motions.items() if k != last["name"]}
        self._open = None
        if self.count:
            write_bytes(self.file, tomlkit.dumps(self.content).encode())
        else:
            self.file.unlink()

    def measured(self) -> Session:
        """The session of all pushes, with their displacements."""
        session = read_session(self.file)
        self._motions = measure_pictures(session, known=self._motions)
        return with_motions(session, self._motions)

    def fit(
        self, measured: Session, *, at_once: bool = False, progress: Progress = silent
    ) -> FittedBody:
        """The constants: of all pushes at once as `palpate fit` finds them; after a push more, with
        what is known of the others, within a twentieth of a standard deviation of these."""
        cache = Memory(self._cache) if at_once and isinstance(self._cache, Memory) else self._cache
        return fitted_body(
            fit_session(measured, cache=cache, material=Material.AUTO, progress=progress)
        )

    def plan(
        self, measured: Session, fitted: FittedBody, *, progress: Progress = silent
    ) -> NextProbings:
        """The next pushes, as `plan_next` finds them, with what it found after the last push."""
        self._plan = plan_next(
            measured, count=_AHEAD, fitted=fitted, known=self._plan, cache=self._cache,
            progress=progress,
        )  # fmt: skip
        return self._plan

    def _force_std(self, taken: TakenPush, inward: Vector3) -> list[float]:
        """Standard deviation of each component [N]: of the gauge along the normal, across it of the
        direction, which nobody measures."""
        turned = taken.force * (_TURNED_BY_HAND if self.by_hand else _TURNED_BY_ARM)
        std: np.ndarray = np.sqrt((taken.force_std * inward) ** 2 + turned**2 * (1.0 - inward**2))
        return std.tolist()

    def _go_on(self) -> None:
        """Take the pushes over that the folder holds, if they are of the same object and bench."""
        there = read_toml(self.file)
        for key in ("object", "support", "rig"):
            if there.values.get(key) != self.content.get(key):
                there.fail(
                    f"[{key}]", "is not that of this bench; choose another folder with --out, or"
                    " correct bench.toml"
                )  # fmt: skip
        # What a person has added stays.
        self.content = {"probe": [], **there.values}

    def _write(self, pattern: str, pictures: Pictures) -> None:
        for camera, picture in zip(self.rig.cameras, pictures, strict=True):
            write_picture(picture_path(camera, pattern, self.folder), picture)

    def _measured(self, session: Session, name: str) -> dict[str, ProbingMotion]:
        """The motions of all pushes; the new one is refused where it shows too little."""
        try:
            motions = measure_pictures(session, known=self._motions)
        except InputError as error:
            raise PushError(f"the pictures of this push cannot be used: {error}") from error
        probing = replace(session.probings[-1], displacement=motions[name].field)
        survey = survey_probing(session, probing)
        if not survey.signal_to_noise >= _CLEAR:
            raise PushError(
                f"too light: half of what moved did so by {survey.signal_to_noise:.1f} standard"
                f" deviations or less ({1e3 * survey.median_displacement:.2g} mm); press harder"
            )
        return motions

    def _check_place(self, taken: TakenPush, after: Pictures) -> None:
        """Refuse a push after which the object is not where it was."""
        slid, pressed = self._remains(taken, after)
        if pressed > _STILL_PRESSED:
            raise PushError(
                f"{100 * min(pressed, 1.0):.0f} % of it is seen after the tool was lifted: does a"
                " camera deliver late, does the tool stick, or does the object hardly spring back?"
            )
        if slid:
            raise PushError(
                f"the object slid by {1e3 * slid:.2g} mm under it: glue or tape it down, or press"
                " less hard"
            )

    def _remains(self, taken: TakenPush, after: Pictures) -> tuple[float, float]:
        """How far the object stands from where it stood before a push [m], 0 where that is little
        of what went back; and how much of its deformation is still there. What creeps back later is
        no slide: it is like what went back."""
        method = JointFlow(step=_STEP)
        state = method.start(self.rig, _grey(taken.rest), self.mesh)
        loaded, left = (method.follow(state, _grey(x))[1] for x in (taken.loaded, after))
        both = is_valid(loaded) & is_valid(left)
        if not both.any():
            return 0.0, 0.0
        points = left.point[both]
        motions = [(x.displacement[both], x.covariance[both]) for x in (left, loaded)]
        remains, moved = (displacement for displacement, _ in motions)
        back = moved - remains
        rigid, sigma = rigid_part(points, *motions[0], like=back)
        slid = _rms(rigid)
        # So many points share the noise of a window.
        sigma *= max(method.subset / method.step, 1.0)
        shapes = [
            max(_rms(x - rigid_part(points, x, c)[0]) ** 2 - np.trace(c.mean(axis=0)), 0.0)
            for x, c in motions
        ]
        # Of noise alone nothing; of what is seen afterwards only, all.
        pressed = float(np.sqrt(shapes[0] / shapes[1])) if shapes[1] else float(shapes[0] > 0.0)
        return slid if slid > max(_SLID * _rms(back), _SURE * sigma) else 0.0, pressed

    def _found_contact(self, motion: ProbingMotion, force: Vector3) -> dict[str, Any]:
        """Contact point with its standard deviation, from the motion of the surface."""
        if self._model is None:
            self._model = make_contact_model(self.mesh, self.bare.held_triangles)
        field = motion.field
        known = np.isfinite(field.displacement).all(axis=1)
        radius = self.contact_radius
        try:
            point, std, _ = find_contact(
                self._model, field.points[known], field.displacement[known], force,
                radius=radius, profile=self.contact.get("profile", "smooth"),
            )  # fmt: skip
        except RecordError as error:
            raise PushError(
                f"the place of this push is not clear from how the surface moved ({error}); press"
                " straight in, on the surface of the mesh"
            ) from error
        return {"point": (point / self.metres).tolist(), "point_std": std / self.metres}

    @property
    def contact_radius(self) -> float:
        """Radius of a contact, about [m]."""
        table = TomlTable(self.file, "[contact]", self.contact)
        key = "radius" if "radius" in self.contact else "tool_radius"
        share = 1.0 if key == "radius" else _TOUCHED
        return share * table.quantity(key, LENGTH_UNITS, self.metres)


def rigid_part(
    points: Points,
    moved: Points,
    covariance: Float[np.ndarray, "n 3 3"],
    *,
    like: Points | None = None,
) -> tuple[Points, float]:
    """The rigid motion in a displacement that is one, and a multiple of another displacement.

    Parameters
    ----------
    points, moved : (n, 3) float [m]
    covariance : (n, 3, 3) float [m^2]  of the displacement; points are independent
    like : (n, 3) float [m] or None     None: a rigid motion alone

    Returns
    -------
    displacement : (n, 3) float [m]     of the points
    sigma : float [m]               root mean square over the points of its standard deviation
    """
    modes = rigid_modes(points, points.mean(axis=0))
    modes = modes / np.linalg.norm(modes, axis=(0, 1))
    if like is not None:
        modes = np.concatenate([modes, like[..., None] / np.linalg.norm(like)], axis=2)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    inverse = np.linalg.pinv((whitening @ modes).reshape(moved.size, -1))[:6]
    rigid = modes[..., :6].reshape(-1, 6)
    share = inverse @ np.einsum("nij,nj->ni", whitening, moved).ravel()
    variance = np.sum((rigid.T @ rigid) * (inverse @ inverse.T)) / len(points)
    return (rigid @ share).reshape(-1, 3), float(np.sqrt(variance))


def _rms(vectors: Points) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def _grey(pictures: Pictures) -> tuple[np.ndarray, ...]:
    return tuple(picture.astype(np.float32) for picture in pictures)
