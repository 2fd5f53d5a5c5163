"""A leg that moves as an OpenSim model says: the user's own, scaled or generic."""

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import ArrayLike

from legsim.core import transforms
from legsim.core.constants import GRAVITY_WORLD
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.kinematics import _osim_segments
from legsim.kinematics._osim_chain import Chain
from legsim.kinematics._osim_functions import is_linear
from legsim.kinematics._osim_roles import bodies_by_segment
from legsim.kinematics.leg_model import Kinematics, SensorMotion, marker_rows
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.osim_file import Coupler, Joint, OsimMarker, OsimModel
from legsim.kinematics.patella import in_femur as patella_in_femur
from legsim.kinematics.skeleton import (
    SEGMENTS,
    JointCenters,
    SegmentPoses,
    segment_index,
)
from legsim.mocap.coordinates import is_rotation
from legsim.mocap.trajectories import JointTrajectories

_PATELLAE = tuple(segment_index(f"patella_{side}") for side in "rl")


class OsimLeg:
    """The legs of an OpenSim model; unchangeable.

    Its coordinates are those of the joints between the ground and the feet, less what is held at
    the model's default and what a coupler sets. ``values`` hold them in the order of
    ``coordinate_names``: radians, and meters for those in ``shifts``.
    """

    def __init__(self, model: OsimModel, *, held: Collection[str] = ()) -> None:
        """Prepares the legs of ``model`` with the coordinates ``held`` at their defaults.

        Raises:
            LegsimError: the model has no two legs, or its legs have a joint, function, constraint
                or axes that legsim does not support; the message names it.
        """
        self.model, self.held = model, tuple(held)
        try:
            self._roles = bodies_by_segment(model.bodies)
            self._chain = Chain(_leg_joints(model, self._roles))
            self._couplers = _leg_couplers(model, self._chain)
            self._prepare(held)
        except LegsimError as error:
            raise LegsimError(f"{model.path}: {error}") from error

    def _prepare(self, held: Collection[str]) -> None:
        chain, dependent = self._chain, {c.dependent for c in self._couplers}
        self._default = np.array([c.default for c in chain.coordinates])
        self._free = np.array(
            [k for k, name in enumerate(chain.names) if name not in dependent and name not in held],
            int,
        )
        neutral = np.array(
            [
                np.clip(0.0, c.low, c.high) if c.name in chain.turning else c.default
                for c in chain.coordinates
            ]
        )
        self._frames = _osim_segments.place(chain, self._roles, self._coupled(neutral[None])[0])
        self.scales = self._frames.scales
        self.notes = self._frames.notes
        self.coordinate_names = tuple(chain.names[k] for k in self._free)
        free = [chain.coordinates[k] for k in self._free]
        bounds = [(c.low, c.high) if c.clamped else (-np.inf, np.inf) for c in free]
        self.coordinate_ranges = frozen("coordinate_ranges", np.reshape(bounds, (-1, 2)), (None, 2))
        self.default_coordinates = frozen("defaults", self._default[self._free], (None,))
        self.shifts = tuple(n for n in self.coordinate_names if n not in chain.turning)
        self.locked = tuple(c.name for c in chain.coordinates if c.locked)
        pelvis = chain.bodies.index(self._roles["pelvis"])
        self.pelvis_coordinates = int(chain.moves[self._free, pelvis].sum())
        self._bodies = np.array(self._frames.bodies)
        self.moves = self._segment_moves()
        self.heading = self._heading()

    def __repr__(self) -> str:
        thigh, shank = (1e3 * f("r") for f in (self.thigh_length, self.shank_length))
        return f"OsimLeg({self.model.name}, thigh {thigh:.0f} mm, shank {shank:.0f} mm)"

    def with_held(self, names: Collection[str]) -> "OsimLeg":
        """The same legs with these coordinates held at their defaults."""
        return OsimLeg(self.model, held=names)

    def values_of(self, trajectories: JointTrajectories) -> FloatArray:
        """Values (n, c) in the model's order; coordinates of other names are left out.

        Raises:
            LegsimError: a coordinate is missing or not a number.
        """
        names = trajectories.coordinate_names
        missing = [name for name in self.coordinate_names if name not in names]
        if missing:
            raise LegsimError(
                f"the motion has no coordinate {', '.join(missing)}; the model needs "
                f"{', '.join(self.coordinate_names)}"
            )
        return self._checked(
            trajectories.values[:, [names.index(name) for name in self.coordinate_names]]
        )

    def segment_poses(self, trajectories: JointTrajectories) -> SegmentPoses:
        """Pose of every segment at every time of ``trajectories``."""
        rotations, origins = self._posed(self.values_of(trajectories))
        return SegmentPoses(trajectories.times, SEGMENTS, transforms.rigid(rotations, origins))

    def body_poses(self, values: ArrayLike) -> dict[str, FloatArray]:
        """world_from_body (n, 4, 4) of the model's own bodies, by name, for values (n, c)."""
        rotations, origins = self._chain.poses(self._all(self._checked(values)))
        poses = transforms.rigid(rotations, origins)
        return {name: poses[:, b] for b, name in enumerate(self._chain.bodies)}

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the model's bodies between the ground and the feet, parents first."""
        return self._chain.bodies

    def body_of(self, segment: str) -> str:
        """Name of the model's body that carries a segment."""
        return self._chain.bodies[self._frames.bodies[segment_index(segment)]]

    def patella_body(self, side: str) -> str:
        """Name of the model's own patella of a side; empty where it has none."""
        return self._roles.get(f"patella_{side}", "")

    def parent_of(self, body: str) -> str:
        """Name of the body that carries one of ``bodies``; ``ground`` of the first."""
        return self._chain.joint_of(self._chain.bodies.index(body)).parent

    def growth(self, values: ArrayLike, factors: FloatArray) -> FloatArray:
        """(n, b, 3, b, 3) shift (m) of the origins of ``bodies`` in world per relative growth of
        each along each of its axes, at values (n, c); ``factors`` (b, 3) are those that the model
        has been scaled by.
        """
        return self._chain.growth(self._all(self._checked(values)), factors)

    def joint_centers(self, poses: SegmentPoses) -> JointCenters:
        """Hip, knee and ankle centers: the origins of femur, tibia and talus."""
        return JointCenters.of_segments(poses)

    def thigh_length(self, side: str) -> float:
        """m, from hip center to knee center with the knee straight; ``side`` is "r" or "l"."""
        return self._frames.thigh[side]

    def shank_length(self, side: str) -> float:
        """m, from knee center to ankle center with all joints at zero."""
        return self._frames.shank[side]

    def kinematics(self, values: ArrayLike) -> Kinematics:
        """Poses and coordinate screws for values (n, c); a coupler's share is in the screw of the
        coordinate that it follows.
        """
        every = self._all(self._checked(values))
        screws = self._chain.screws(every)
        angular, linear = screws.angular, screws.linear
        for c in reversed(self._couplers):
            d, i = (self._chain.names.index(name) for name in (c.dependent, c.independent))
            slope = c.function.with_derivatives(every[:, i])[1][:, None]
            angular[:, i] += slope * angular[:, d]
            linear[:, i] += slope * linear[:, d]
        rotations, origins = self._on_segments(screws.rotations, screws.origins)
        return Kinematics(rotations, origins, angular[:, self._free], linear[:, self._free])

    def posture(self, hip: float, knee: float, ankle: float) -> FloatArray:
        """Coordinates (c,) with both legs bent: turns (rad) of each joint about the axis to the
        right, by the coordinate that turns it most about that.
        """
        values = self.default_coordinates.copy()
        pose = self.kinematics(values[None])
        right = pose.rotations[0, 0, :, 2]
        steps = (("pelvis", "femur", hip), ("femur", "tibia", knee), ("tibia", "talus", ankle))
        for upper, lower, angle in steps:
            for side in "rl":
                above = segment_index(upper if upper == "pelvis" else f"{upper}_{side}")
                own = self.moves[:, segment_index(f"{lower}_{side}")] & ~self.moves[:, above]
                rate = np.where(own, pose.angular[0] @ right, 0.0)
                column = int(np.abs(rate).argmax())
                if abs(rate[column]) > 0.5:
                    low, high = self.coordinate_ranges[column]
                    values[column] = np.clip(angle / rate[column], low, high)
        return values

    def pelvis_values(self, world_from_pelvis: FloatArray) -> FloatArray:
        """The pelvis' coordinates (n, p) at which it is nearest to poses (n, 4, 4): Gauss and
        Newton's method from four headings.
        """
        poses, p = np.asarray(world_from_pelvis, float), self.pelvis_coordinates
        best, least = np.zeros((len(poses), p)), np.full(len(poses), np.inf)
        for heading in np.radians((0.0, 90.0, 180.0, -90.0)):
            values = np.tile(self.default_coordinates, (len(poses), 1))
            if self.heading is not None:
                values[:, self.heading] = heading
            for _ in range(30):
                away, slope = self._pelvis_off(values, poses)
                step = np.einsum("npk,nk->np", np.linalg.pinv(slope, rcond=1e-9), away)
                values[:, :p] += np.clip(step, -1.0, 1.0)
                if np.abs(step).max() < 1e-13:
                    break
            cost = (self._pelvis_off(values, poses)[0] ** 2).sum(1)
            better = cost < least - 1e-12
            best[better], least[better] = values[better, :p], cost[better]
        return best

    def marker_positions(self, values: ArrayLike, sites: MarkerSites) -> FloatArray:
        """Where the markers are in world, (n, m, 3), for values (n, c)."""
        rotations, origins = self._posed(self._checked(values))
        rows = [segment_index(s) for s in sites.segments]
        return origins[:, rows] + np.einsum("nmij,mj->nmi", rotations[:, rows], sites.positions)

    def marker_jacobians(self, values: ArrayLike, sites: MarkerSites) -> FloatArray:
        """Derivatives (n, m, 3, c) of the marker positions by the coordinates.

        Raises:
            LegsimError: a marker sits on a patella.
        """
        rows, pose = marker_rows(sites), self.kinematics(values)
        points = pose.origins[:, rows] + np.einsum(
            "nmij,mj->nmi", pose.rotations[:, rows], sites.positions
        )
        columns = pose.linear[:, None] + np.cross(pose.angular[:, None], points[:, :, None])
        jacobians = np.where(self.moves.T[rows][None, :, :, None], columns, 0.0)
        return np.swapaxes(jacobians, -1, -2)

    def attached_motion(
        self,
        values: ArrayLike,
        rates: ArrayLike,
        accelerations: ArrayLike,
        *,
        segment: str,
        segment_from_sensor: ArrayLike,
    ) -> SensorMotion:
        """What a sensor fixed to ``segment`` goes through, exactly, from the coordinates (n, c) and
        their first and second time derivatives.

        Raises:
            LegsimError: an unknown segment, a patella, or a value that is not a number.
        """
        row = segment_index(segment)
        if row in _PATELLAE:
            raise LegsimError(
                f"a sensor on {segment} of an OpenSim model is not supported; attach it to the "
                "femur or tibia"
            )
        state = self._all_in_time(
            self._checked(values), self._checked(rates), self._checked(accelerations)
        )
        jet = self._chain.jets(*state, self._frames.bodies[row])
        on_body = self._frames.body_from_segment[row] @ np.asarray(segment_from_sensor, float)
        pose, first, second = (part @ on_body for part in jet)
        turn = pose[:, :3, :3]
        spin = np.swapaxes(turn, 1, 2) @ first[:, :3, :3]
        omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1)
        force = np.einsum("nji,nj->ni", turn, second[:, :3, 3] - GRAVITY_WORLD)
        return SensorMotion(pose, omega, force)

    def complete(self, trajectories: JointTrajectories) -> JointTrajectories:
        """The same motion with the coordinates that are held or that couplers set, those of a
        patella too.
        """
        every = self._all(self.values_of(trajectories))
        names, columns = list(self._chain.names), [*every.T]
        for c in self.model.couplers:
            if c.dependent not in names and c.independent in names and not c.problem:
                columns.append(c.function.with_derivatives(columns[names.index(c.independent)])[0])
                names.append(c.dependent)
        return JointTrajectories(trajectories.times, tuple(names), np.stack(columns, 1))

    def marker_sites(self) -> tuple[MarkerSites, tuple[str, ...]]:
        """The model's markers on the segments, and the names of those on other bodies."""
        carriers = {
            self._roles[s]: k
            for k, s in enumerate(SEGMENTS)
            if s in self._roles and k not in _PATELLAE
        }
        here = self._markers_on(carriers)
        rows = [carriers[m.body] for m in here]
        places = [
            transforms.apply(
                transforms.inverse(self._frames.body_from_segment[row]), m.location[None]
            )[0]
            for m, row in zip(here, rows, strict=True)
        ]
        sites = MarkerSites(
            tuple(m.name for m in here),
            tuple(SEGMENTS[row] for row in rows),
            np.reshape(places, (-1, 3)),
            np.ones(len(here)),
        )
        return sites, tuple(m.name for m in self.model.markers if m.body not in carriers)

    def _markers_on(self, bodies: Collection[str]) -> list[OsimMarker]:
        """The markers on some bodies, one that is there twice at one place once.

        Raises:
            LegsimError: two places have one name.
        """
        found: dict[str, OsimMarker] = {}
        for marker in self.model.markers:
            if marker.body in bodies:
                same = found.setdefault(marker.name, marker)
                if same.body != marker.body or not np.allclose(same.location, marker.location):
                    raise LegsimError(
                        f"{self.model.path} (MarkerSet): two markers are named {marker.name}, on "
                        f"{same.body} and {marker.body}; rename one"
                    )
        return list(found.values())

    def rotations(self, columns: Sequence[str] = ()) -> frozenset[str]:
        """Names of all coordinates of the model that a file in degrees has in degrees: those that
        turn a joint by themselves, not through a function; and of its ``columns`` of another model,
        which are left out but must not look like what no joint can be, those that are by name.
        """
        joints = self.model.joints
        known = {axis.coordinate for j in joints for axis in (*j.rotations, *j.translations)}
        return frozenset(
            axis.coordinate for j in joints for axis in j.rotations if is_linear(axis.function)
        ) | {name for name in columns if name not in known and is_rotation(name)}

    def bodies_left_out(self) -> tuple[str, ...]:
        """Names of the model's bodies that are no part of the legs."""
        return tuple(name for name in self.model.bodies if name not in self._chain.bodies)

    def _checked(self, values: ArrayLike) -> FloatArray:
        array, names = np.ascontiguousarray(values, float), self.coordinate_names
        if array.ndim != 2 or array.shape[1] != len(names):
            raise LegsimError(f"coordinates have shape {array.shape}; expected (n, {len(names)})")
        if not np.isfinite(array).all():
            row, column = np.argwhere(~np.isfinite(array))[0]
            raise LegsimError(f"coordinate {names[column]} is not a number at sample {row}")
        return array

    def _all(self, values: FloatArray) -> FloatArray:
        """Every coordinate of the chain (n, all), from the free ones (n, c)."""
        every = np.tile(self._default, (len(values), 1))
        every[:, self._free] = values
        return self._coupled(every)

    def _coupled(self, every: FloatArray) -> FloatArray:
        for c in self._couplers:
            d, i = (self._chain.names.index(name) for name in (c.dependent, c.independent))
            every[:, d] = c.function.with_derivatives(every[:, i])[0]
        return every

    def _all_in_time(
        self, values: FloatArray, rates: FloatArray, accelerations: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Every coordinate with its time derivatives, coupled ones by the chain rule."""
        every = self._all(values)
        first, second = np.zeros_like(every), np.zeros_like(every)
        first[:, self._free], second[:, self._free] = rates, accelerations
        for c in self._couplers:
            d, i = (self._chain.names.index(name) for name in (c.dependent, c.independent))
            _, slope, bend = c.function.with_derivatives(every[:, i])
            first[:, d] = slope * first[:, i]
            second[:, d] = slope * second[:, i] + bend * first[:, i] ** 2
        return every, first, second

    def _posed(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._on_segments(*self._chain.poses(self._all(values)))

    def _on_segments(
        self, rotations: FloatArray, origins: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Rotations (n, 13, 3, 3) and origins (n, 13, 3) of the segments, from those of the
        bodies.
        """
        local, bodies = self._frames.body_from_segment, self._bodies
        turns = rotations[:, bodies] @ local[:, :3, :3]
        places = origins[:, bodies] + (rotations[:, bodies] @ local[:, :3, 3, None])[..., 0]
        for side, patella in zip("rl", _PATELLAE, strict=True):
            f, t = segment_index(f"femur_{side}"), segment_index(f"tibia_{side}")
            on_femur = patella_in_femur(
                np.swapaxes(turns[:, f], 1, 2) @ turns[:, t], self.scales.factors[f], side
            )
            places[:, patella] = places[:, f] + (turns[:, f] @ on_femur[:, :3, 3:])[..., 0]
            turns[:, patella] = turns[:, f] @ on_femur[:, :3, :3]
        return turns, places

    def _segment_moves(self) -> np.ndarray:
        """(c, 13) whether a coordinate moves a segment by its screw; a patella as its femur.

        Raises:
            LegsimError: a coupler makes one coordinate move segments in different ways.
        """
        chain = self._chain
        by_segment = chain.moves[:, self._bodies]
        for c in self._couplers:
            d, i = (chain.names.index(name) for name in (c.dependent, c.independent))
            if (by_segment[d] != by_segment[i]).any():
                raise LegsimError(
                    f"the constraint {c.name} couples {c.dependent} to {c.independent}, a "
                    "coordinate of another joint of the legs, which is not supported; disable it"
                )
        moves = by_segment[self._free]
        moves.flags.writeable = False
        return moves

    def _heading(self) -> int | None:
        """Column of the pelvis' coordinate that turns nearest to the vertical."""
        pose = self.kinematics(self.default_coordinates[None])
        up = np.abs(pose.angular[0, : self.pelvis_coordinates, 1])
        return int(up.argmax()) if len(up) and up.max() > 0.7 else None

    def _pelvis_off(self, values: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 6) turn and shift from the pelvis at values (n, c) to poses, and its slope (n, 6,
        p).
        """
        pose, p = self.kinematics(values), self.pelvis_coordinates
        turn = transforms.vector_from_rotation(
            poses[:, :3, :3] @ np.swapaxes(pose.rotations[:, 0], 1, 2)
        )
        origin = pose.origins[:, 0]
        angular = pose.angular[:, :p]
        linear = pose.linear[:, :p] + np.cross(angular, origin[:, None])
        slope = np.swapaxes(np.concatenate([angular, linear], -1), 1, 2)
        return np.concatenate([turn, poses[:, :3, 3] - origin], -1), slope


def _leg_joints(model: OsimModel, roles: dict[str, str]) -> list[Joint]:
    """Joints between the ground and the segments, parents first; those of the pelvis before all.

    Raises:
        LegsimError: one of them is not supported, or a body hangs on nothing.
    """
    wanted = [body for segment, body in roles.items() if not segment.startswith("patella")]
    joints: list[Joint] = []
    for body in wanted:
        path: list[Joint] = []
        while body != "ground" and body not in {joint.child for joint in (*joints, *path)}:
            joint = model.joint_of(body)
            if joint is None:
                raise LegsimError(f"the body {body} has no joint to a parent")
            if joint.problem:
                raise LegsimError(f"joint {joint.name} ({joint.kind}): {joint.problem}")
            path.append(joint)
            body = joint.parent
            if len(path) > len(model.joints):
                raise LegsimError(f"the joints from {path[0].child} to the ground form a loop")
        joints += reversed(path)
    names = [c.name for joint in joints for c in joint.coordinates]
    doubles = sorted({name for name in names if names.count(name) > 1})
    if doubles:
        raise LegsimError(f"two coordinates of the legs are named {doubles[0]}; rename one")
    return joints


def _leg_couplers(model: OsimModel, chain: Chain) -> tuple[Coupler, ...]:
    """Couplers of the legs' coordinates, each after the one that it hangs on.

    Raises:
        LegsimError: one is not supported, or another enforced constraint holds the legs.
    """
    for other in model.constraints:
        held = sorted(other.mentions & {*chain.bodies, *chain.names})
        if held:
            raise LegsimError(
                f"the constraint {other.name} ({other.kind}) holds {', '.join(held)}; only "
                "CoordinateCouplerConstraint is supported in the legs: disable it"
            )
    left = [c for c in model.couplers if c.dependent in chain.names]
    for c in left:
        if c.problem or c.independent not in chain.names:
            problem = c.problem or f"{c.independent} is no coordinate of the legs"
            raise LegsimError(f"the constraint {c.name} ({c.dependent}): {problem}")
    ordered: list[Coupler] = []
    while left:
        open_names = {c.dependent for c in left}
        ready = [c for c in left if c.independent not in open_names]
        if not ready:
            raise LegsimError(
                f"the constraints {', '.join(c.name for c in left)} couple coordinates in a circle"
            )
        ordered += ready
        left = [c for c in left if c not in ready]
    doubles = [c.dependent for c in ordered]
    if len(set(doubles)) < len(doubles):
        raise LegsimError(f"two constraints set one coordinate: {', '.join(sorted(doubles))}")
    return tuple(ordered)
