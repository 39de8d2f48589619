"""Draws robot, ground, target and sky in the browser, with viser."""

from collections import defaultdict

import mujoco
import numpy as np
import viser

from arrive.play.colours import PALETTE, Rgb, palette
from arrive.play.playground import TERRAIN_GROUP, Playground
from arrive.play.shapes import Triangles, cylinder, geom_triangles, joined, revolved
from arrive.play.surfaces import ground_surface, linear, robot_surface
from arrive.play.trail import Trail
from arrive.play.view import FIELD_OF_VIEW_RAD, HORIZON, ZENITH, first_view, pitch, sky
from arrive.simulation import SimulatedRobot

WORLD = "/world"
"""Parent frame of everything. It moves opposite to the robot, so that the camera seems to follow."""
VISUAL_GROUP, COLLISION_GROUP = 2, 3
"""Groups of a robot's geoms (`arrive.robots.robot`): the visible ones, and those that collide with the ground."""
PARKED_BELOW = -50.0
"""Terrain geoms below this height are unused [m]."""
IDLE, SENT, REACHED = (250, 226, 196), PALETTE[1], PALETTE[2]
"""Colours of the target: before the robot is sent there, while it walks there, and when it has arrived."""
RIM = 0.02
"""Width of the ring around the target [m]."""
FOG_M = (14.0, 70.0)
"""Distances at which the ground begins to fade into the horizon, and at which it has faded [m]."""
SKY_STEP_RAD = 0.004
"""The sky is drawn again when the camera's pitch has changed by this much."""
USUAL_ASPECT = 1.4
"""Assumed width over height of a picture, until the browser has sent it."""
SUN = (-3.0, 4.0, 7.0)
"""Position of the sun, which gives the direction of its light [m]."""
FADED: Rgb = (200, 200, 196)
"""Colour of the oldest piece of the feet's trail."""
LIFT_SHARE = 0.08
"""Share of the height difference to the robot by which the camera moves in each picture."""
Meshes = dict[tuple[float, ...], Triangles]


class Scene:
    """The drawn objects. Bodies have the names of the compiled model."""

    def __init__(self, server: viser.ViserServer, playground: Playground):
        """Add sky, light, robot, ground and target."""
        self._server = server
        server.scene.set_up_direction("+z")
        self._add_sky()
        self._world = server.scene.add_frame(WORLD, show_axes=False)
        self._lift = 0.0
        self._robot: viser.FrameHandle | None = None
        self._ground: viser.FrameHandle | None = None
        self.show(playground)
        view = first_view(*self._ends(playground), USUAL_ASPECT)
        server.initial_camera.position, server.initial_camera.look_at = view.position, view.look_at
        server.initial_camera.fov = FIELD_OF_VIEW_RAD
        self.gizmo = self._add_target(playground)
        self._trail = server.scene.add_line_segments(
            f"{WORLD}/trail", np.zeros((0, 2, 3)), np.zeros((0, 2, 3), dtype=np.uint8), thickness=0.012
        )

    def show(self, playground: Playground) -> None:
        """Replace the robot and its ground by the playground's."""
        robot = playground.robot
        with self._server.atomic():
            for part in filter(None, (self._robot, self._ground)):
                part.remove()
            self._robot = self._server.scene.add_frame(f"{WORLD}/robot", show_axes=False)
            self._links = self._add_robot(robot)
            self._ground = self._server.scene.add_frame(f"{WORLD}/ground", show_axes=False)
            self._add_ground(self._ground.name, robot.model)
        self._lift = 0.0

    def update(self, robot: SimulatedRobot, follow: bool) -> None:
        """Move the links to the robot's present pose. With `follow`, the robot stays in the middle of the picture."""
        with self._server.atomic():
            for body, frame in self._links.items():
                frame.position = robot.data.xpos[body]
                frame.wxyz = robot.data.xquat[body]
            x, y, z = robot.base_pos_w if follow else (0.0, 0.0, robot.robot.standing_height)
            # Slowly: otherwise the ground would shake with every step of the robot.
            self._lift += LIFT_SHARE * (z - robot.robot.standing_height - self._lift)
            self._world.position = (-x, -y, -self._lift)

    def look(self, client: viser.ClientHandle, playground: Playground) -> None:
        """Point a browser's camera along the way to the target."""
        camera = client.camera
        view = first_view(*self._ends(playground), camera.image_width / max(camera.image_height, 1))
        with client.atomic():
            camera.position = view.position
            camera.look_at = view.look_at

    def show_target(self, position: tuple[float, float, float], colour: Rgb) -> None:
        """Move the target to a position [m]."""
        with self._server.atomic():
            self.gizmo.position = position
            for part in self._marks:
                part.color = colour  # type: ignore[attr-defined]  # viser's stubs leave colours out

    def show_trail(self, trail: Trail, feet: int, visible: bool) -> None:
        """Draw the trail of the feet."""
        newest = np.array([in_linear_light(colour) for colour in palette(feet)])
        points, colours = trail.segments(newest, np.array(in_linear_light(FADED)))
        with self._server.atomic():
            self._trail.points, self._trail.colors = points.astype(np.float32), colours
            self._trail.visible = visible

    def in_world(self, point: tuple[float, float, float]) -> np.ndarray:
        """(3,) position of a point in the simulation, from its position in viser's own frame [m]."""
        return np.array(point) - self._world.position

    def _ends(self, playground: Playground) -> tuple[np.ndarray, np.ndarray]:
        """Positions of robot and target in viser's own frame [m]."""
        return playground.robot.base_pos_w + self._world.position, np.array(playground.aim) + self._world.position

    def _add_sky(self) -> None:
        """Add a sun with shadows, ambient light, haze and the sky, which moves with every camera."""
        scene = self._server.scene
        scene.configure_fog(*FOG_M, color=in_linear_light(HORIZON))
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map("park", environment_intensity=0.25)
        scene.add_light_hemisphere("/light/sky", sky_color=ZENITH, ground_color=(150, 140, 128), intensity=1.1)
        scene.add_light_directional("/light/sun", color=(255, 244, 226), intensity=2.6, cast_shadow=True, position=SUN)
        self._server.on_client_connect(_keep_horizon)

    def _add_robot(self, robot: SimulatedRobot) -> dict[int, viser.FrameHandle]:
        """Add one frame per moving link. Bodies that are welded together share a frame."""
        model = robot.model
        group = VISUAL_GROUP if (model.geom_group == VISUAL_GROUP).any() else COLLISION_GROUP
        frames = {}
        for body in np.unique(model.body_weldid[1:]):
            name = f"{WORLD}/robot/{model.body(body).name}"
            frames[int(body)] = self._server.scene.add_frame(name, show_axes=False)
            for number, (rgba, mesh) in enumerate(link_meshes(model, int(body), group).items()):
                self._server.scene.add_glb(f"{name}/{number}", robot_surface(mesh, _rgb(rgba)))
        return frames

    def _add_ground(self, name: str, model: mujoco.MjModel) -> None:
        """Add the terrain, one surface per colour."""
        for number, (rgba, mesh) in enumerate(link_meshes(model, 0, TERRAIN_GROUP).items()):
            self._server.scene.add_glb(f"{name}/{number}", ground_surface(mesh, _rgb(rgba)))

    def _add_target(self, playground: Playground) -> viser.TransformControlsHandle:
        """Add the target that can be dragged: a pole, and a disc of the arrival radius."""
        scene, name, task = self._server.scene, f"{WORLD}/target", playground.skill.policy.task
        gizmo = scene.add_transform_controls(
            name, scale=0.6, active_axes=(True, True, False), disable_rotations=True, position=playground.aim
        )
        height = task.target_height_m
        radius = task.arrival_radius_m
        disc, pole = cylinder(radius, 0.004), cylinder(0.012, height / 2)
        # Both sides of the ring: up its outer side, down its inner side.
        rim = revolved([(radius, -RIM), (radius, RIM), (radius - RIM, RIM), (radius - RIM, -RIM)])
        parts = (
            ("disc", disc, 0.012 - height, 0.35),
            ("rim", rim, 0.012 - height, None),
            ("pole", pole, -height / 2, None),
        )
        marks = [
            scene.add_mesh_simple(
                f"{name}/{part}",
                mesh.vertices,
                mesh.faces,
                color=IDLE,
                opacity=opacity,
                position=(0.0, 0.0, z),
                cast_shadow=False,
            )
            for part, mesh, z, opacity in parts
        ]
        ball = scene.add_icosphere(f"{name}/ball", radius=0.07, color=IDLE, cast_shadow=False)
        self._marks = (*marks, ball)
        return gizmo


def _keep_horizon(client: viser.ClientHandle) -> None:
    """Keep the sky's horizon at the end of the ground, whatever the pitch of a browser's camera.

    viser only has a background image, which does not turn with the camera.
    """
    drawn = np.inf

    def draw(camera: viser.CameraHandle) -> None:
        nonlocal drawn
        up = pitch(camera.look_at - camera.position)
        if abs(up - drawn) > SKY_STEP_RAD:
            drawn = up
            client.scene.set_background_image(sky(up, camera.fov), format="png")

    draw(client.camera)
    client.camera.on_update(draw)


def in_linear_light(colour: Rgb) -> Rgb:
    """An sRGB colour in linear light, both 0 to 255. viser needs it for fog and lines."""
    return _rgb(linear(colour))


def link_meshes(model: mujoco.MjModel, body: int, group: int) -> Meshes:
    """Surfaces of all geoms of a group that are fixed to a body, by colour, in the body's frame [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    origin, rotation = data.xpos[body], data.xmat[body].reshape(3, 3)
    parts = defaultdict(list)
    for geom in np.flatnonzero(model.geom_group == group):
        if model.body_weldid[model.geom_bodyid[geom]] != body or data.geom_xpos[geom, 2] < PARKED_BELOW:
            continue
        position = (data.geom_xpos[geom] - origin) @ rotation
        turn = rotation.T @ data.geom_xmat[geom].reshape(3, 3)
        parts[tuple(model.geom_rgba[geom].tolist())].append(geom_triangles(model, int(geom)).placed(position, turn))
    return {rgba: joined(meshes) for rgba, meshes in parts.items()}


def _rgb(rgba: tuple[float, ...]) -> Rgb:
    red, green, blue = (round(255 * channel) for channel in rgba[:3])
    return red, green, blue
