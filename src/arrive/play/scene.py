"""The robot, its ground and its target, drawn in the browser by viser."""

from collections import defaultdict

import mujoco
import numpy as np
import viser

from arrive.play.playground import TERRAIN_GROUP
from arrive.play.shapes import Triangles, cylinder, geom_triangles, joined
from arrive.robots.anymal_c_visuals import VISUAL_GROUP
from arrive.simulation import SimulatedRobot
from arrive.terrain.tile import RASTER_HALF, RASTER_SIZE, Tile, cell_centers

WORLD = "/world"
"""Everything hangs on this frame; moving it against the robot lets the camera follow."""
PARKED_BELOW = -50.0
"""Terrain geoms lower than this are unused ones [m]."""
LINE_SPACING = 1.0
"""Distance between the lines on the ground [m]."""
LINE_LIFT = 0.006
"""Lines lie this much above the ground, so that they do not flicker [m]."""
LINE_COLOUR = (96, 96, 92)
ACTIVE, IDLE = (224, 122, 31), (150, 150, 150)
"""Colour of the target while the robot is sent there, and while it is not."""
CAMERA = (-2.7, -2.7, 1.9)
"""Where a new browser looks from, towards the robot's start [m]."""


class Scene:
    """What the canvas shows; names of bodies are those of the compiled model."""

    def __init__(self, server: viser.ViserServer, robot: SimulatedRobot, arrival_radius: float, target_height: float):
        """Send everything that keeps its shape: the robot's links and the target.

        Args:
            arrival_radius: of the ring around the target [m].
            target_height: of the target above the ground [m].
        """
        self._server = server
        server.scene.set_up_direction("+z")
        server.initial_camera.position = CAMERA
        server.initial_camera.look_at = (0.5, 0.0, 0.3)
        self._world = server.scene.add_frame(WORLD, show_axes=False)
        self._links = self._add_robot(robot)
        self._target_height = target_height
        self.gizmo = self._add_target(arrival_radius)
        self._ground = server.scene.add_frame(f"{WORLD}/ground", show_axes=False)
        self.show_ground(robot)

    def show_ground(self, robot: SimulatedRobot) -> None:
        """Replace the ground by the tile that the robot stands on."""
        with self._server.atomic():
            self._ground.remove()
            self._ground = self._server.scene.add_frame(f"{WORLD}/ground", show_axes=False)
            self._add_body(self._ground.name, robot.model, 0, TERRAIN_GROUP)
            lines = f"{self._ground.name}/lines"
            self._server.scene.add_line_segments(
                lines, draped_lines(robot.tile), LINE_COLOUR, thickness=1.0, thickness_units="screen"
            )

    def update(self, robot: SimulatedRobot, follow: bool) -> None:
        """Move the links to where the robot is; `follow` keeps the robot in the middle of the picture."""
        with self._server.atomic():
            for body, frame in self._links.items():
                frame.position = robot.data.xpos[body]
                frame.wxyz = robot.data.xquat[body]
            x, y = robot.base_pos_w[:2] if follow else (0.0, 0.0)
            self._world.position = (-x, -y, 0.0)

    def show_target(self, position: tuple[float, float, float] | None) -> None:
        """Move the target there [m]; None says that the robot is not sent to any."""
        with self._server.atomic():
            if position is not None:
                self.gizmo.position = position
            for part in self._marks:
                part.color = IDLE if position is None else ACTIVE

    def in_world(self, point: tuple[float, float, float]) -> np.ndarray:
        """(3,) position in the simulation of a point in viser's own frame [m]."""
        return np.array(point) - self._world.position

    def _add_robot(self, robot: SimulatedRobot) -> dict[int, viser.FrameHandle]:
        """One frame per moving link; bodies that are welded together share one."""
        model = robot.model
        frames = {}
        for body in np.unique(model.body_weldid[1:]):
            name = f"{WORLD}/robot/{model.body(body).name}"
            frames[int(body)] = self._server.scene.add_frame(name, show_axes=False)
            self._add_body(name, model, int(body), VISUAL_GROUP)
        return frames

    def _add_body(self, parent: str, model: mujoco.MjModel, body: int, group: int) -> None:
        """Add the geoms of a link, one mesh per colour."""
        for number, (rgba, mesh) in enumerate(link_meshes(model, body, group).items()):
            colour = tuple(round(255 * channel) for channel in rgba[:3])
            self._server.scene.add_mesh_simple(f"{parent}/{number}", mesh.vertices, mesh.faces, color=colour)

    def _add_target(self, arrival_radius: float) -> viser.TransformControlsHandle:
        """A gizmo to be dragged, with a pole that stands in a disc as large as the place to be reached."""
        scene, name = self._server.scene, f"{WORLD}/target"
        gizmo = scene.add_transform_controls(
            name,
            scale=0.7,
            active_axes=(True, True, False),
            disable_rotations=True,
            position=(2.0, 0.0, self._target_height),
        )
        height = self._target_height
        disc, pole = cylinder(arrival_radius, 0.004), cylinder(0.012, height / 2)
        for part, mesh, z, opacity in (("disc", disc, -height + 0.008, 0.5), ("pole", pole, -height / 2, None)):
            scene.add_mesh_simple(
                f"{name}/{part}", mesh.vertices, mesh.faces, color=IDLE, opacity=opacity, position=(0.0, 0.0, z)
            )
        scene.add_icosphere(f"{name}/ball", radius=0.06, color=IDLE)
        self._marks = [scene.get_handle_by_name(f"{name}/{part}") for part in ("disc", "pole", "ball")]
        return gizmo


def link_meshes(model: mujoco.MjModel, body: int, group: int) -> dict[tuple[float, ...], Triangles]:
    """Surfaces by colour of all geoms of a group that are fixed to a body, in its frame [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    origin, rotation = data.xpos[body], data.xmat[body].reshape(3, 3)
    parts = defaultdict(list)
    for geom in np.flatnonzero(model.geom_group == group):
        if model.body_weldid[model.geom_bodyid[geom]] != body or data.geom_xpos[geom, 2] < PARKED_BELOW:
            continue
        position = (data.geom_xpos[geom] - origin) @ rotation
        turn = rotation.T @ data.geom_xmat[geom].reshape(3, 3)
        parts[tuple(model.geom_rgba[geom].tolist())].append(geom_triangles(model, geom).placed(position, turn))
    return {rgba: joined(meshes) for rgba, meshes in parts.items()}


def draped_lines(tile: Tile) -> np.ndarray:
    """(n, 2, 3) ends of line segments that lie on the ground, parallel to x and y, `LINE_SPACING` apart [m]."""
    centers = cell_centers()
    places = np.arange(-RASTER_HALF + LINE_SPACING, RASTER_HALF, LINE_SPACING)
    segments = []
    for place in places:
        row = min(int(np.searchsorted(centers, place)), RASTER_SIZE - 1)
        fixed = np.full(RASTER_SIZE, place)
        segments.append(_polyline(np.stack([fixed, centers, tile.heights[row]], axis=1)))
        segments.append(_polyline(np.stack([centers, fixed, tile.heights[:, row]], axis=1)))
    return np.concatenate(segments) + np.array([0.0, 0.0, LINE_LIFT])


def _polyline(points: np.ndarray) -> np.ndarray:
    """(m, 2, 3) segments through points (n, 3), without those on a straight line between their neighbours."""
    bends = np.abs(np.diff(points[:, 2], n=2)) > 1e-5
    kept = points[np.concatenate([[True], bends, [True]])]
    return np.stack([kept[:-1], kept[1:]], axis=1)
