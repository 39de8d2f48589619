"""`arrive play` from end to end: the page in headless Chromium, used as a person would."""

import base64
import io
import math
import shutil
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from PIL import Image

from arrive.play.playground import Playground
from arrive.play.skills import open_skill
from arrive.play.stick import CENTRE, parse_stick
from arrive.terrain.ground import ground_of
from ports import free_port

session = pytest.importorskip("arrive.play.session", reason="viser is not installed")
server = pytest.importorskip("arrive.play.server", reason="viser is not installed")
webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="there is no chromium with its chromedriver"),
]
OPTIONS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-unsafe-swiftshader",
]
PATIENCE_S = 180.0
FEW_PICTURES = """
let wait = 250;
const drawn = () => {
  const canvas = document.querySelector("canvas[data-engine]");
  const gl = canvas && canvas.getContext("webgl2");
  if (gl) gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
};
window.requestAnimationFrame = (draw) => setTimeout(() => {
  const start = performance.now();
  draw(start);
  drawn();
  wait = Math.max(250, 4 * (performance.now() - start));
}, wait);
window.cancelAnimationFrame = clearTimeout;
"""
"""A CPU draws the pictures: four a second at most, and in a fifth of the time, so that a busy machine answers too."""
STICK_TRAVEL_PX = 46


class Stage:
    """A running session and the browsers that look at it."""

    def __init__(self, folder):
        """Serve flat ground on a free port, without shadows and with few pictures a second: a CPU has to draw them."""
        self.port = free_port()
        self.folder = folder
        self.playground = Playground(open_skill(None), ground_of("flat"))
        self.server, _ = server.open_server("127.0.0.1", self.port)
        self.session = session.Session(self.server, self.playground)
        self.server.scene.get_handle_by_name("/light/sun").cast_shadow = False
        self.server.scene.configure_environment_map(None)
        # Else every picture is another one.
        self.session._panel._follow.value = False
        self.browsers = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.session.run, args=(self._stop,))
        self._thread.start()

    def open_page(self, width: int = 1150, height: int = 640):
        """A new browser that has loaded the page."""
        options = webdriver.ChromeOptions()
        options.binary_location = CHROMIUM
        own = (f"--window-size={width},{height}", f"--user-data-dir={self.folder / str(len(self.browsers))}")
        for option in (*OPTIONS, *own):
            options.add_argument(option)
        browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
        self.browsers.append(browser)
        browser.set_script_timeout(PATIENCE_S)
        browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": FEW_PICTURES})
        # Fewer pixels, for the same reason.
        browser.get(f"http://127.0.0.1:{self.port}/?fixedDpr=0.4")
        wait_for_page(browser)
        return browser

    def close(self):
        """End browsers, thread and server."""
        for browser in self.browsers:
            browser.quit()
        self._stop.set()
        self._thread.join()
        self.server.stop()


def wait_until(condition: Callable[[], object], what: str) -> None:
    """Wait for something to become true."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, f"waited {PATIENCE_S:g} s in vain: {what}"
        time.sleep(0.05)


def wait_for_page(browser) -> None:
    wait_until(lambda: browser.execute_script("return !!window.arriveStick"), "the page's controls")
    wait_until(lambda: shows_robot(browser), "a picture with the robot")
    # That the picture is drawn by a CPU is known, and the note that says so lies over it.
    for note in browser.find_elements("css selector", "[class*=Notification-closeButton]"):
        browser.execute_script("arguments[0].click()", note)


def picture(browser) -> np.ndarray:
    """(height, width, 3) what the canvas shows, 0 to 255; between two drawings its buffer reads as black."""
    drawn: list[np.ndarray] = []
    wait_until(lambda: drawn.append(buffer(browser)) or drawn[-1].any(), "a drawn picture")
    return drawn[-1]


def buffer(browser) -> np.ndarray:
    """(height, width, 3) the canvas' drawing buffer, 0 to 255."""
    url = browser.execute_script("return document.querySelector('canvas[data-engine]').toDataURL('image/png')")
    image = Image.open(io.BytesIO(base64.b64decode(url.split(",")[1])))
    return np.asarray(image.convert("RGB"), dtype=float)


def shows_robot(browser) -> bool:
    """Whether enough of the picture is as red as the robot's shell."""
    red, green, blue = np.moveaxis(picture(browser), -1, 0)
    return ((red > 60) & (red > 2 * green) & (red > 2 * blue)).mean() > 0.0012


def is_red(browser, place: tuple[int, int]) -> bool:
    """Whether the picture is red, as the target's arrow along x, at a place on the page [px]."""
    shown, (left, top, width, _) = picture(browser), canvas_box(browser)
    x, y = (round((a - b) * shown.shape[1] / width) for a, b in zip(place, (left, top), strict=True))
    red, green, blue = np.moveaxis(shown[y - 3 : y + 4, x - 3 : x + 4], -1, 0)
    return bool(((red > 120) & (red > 1.6 * green) & (red > 1.3 * blue)).any())


def canvas_box(browser) -> list[float]:
    """Left, top, width and height of the picture on the page [px]."""
    return browser.execute_script(
        "const box = document.querySelector('canvas[data-engine]').getBoundingClientRect();"
        "return [box.left, box.top, box.width, box.height]"
    )


def text(browser) -> str:
    return browser.execute_script("return document.body.innerText")


def inputs(browser) -> list[str]:
    return browser.execute_script("return [...document.querySelectorAll('input')].map((input) => input.value)")


def covered(browser) -> float:
    """Share of the window's height that a phone's sheet covers."""
    return browser.execute_script(
        "const sheet = document.querySelector('[style*=\"min-height: 3.5em\"]');"
        "return sheet.getBoundingClientRect().height / innerHeight"
    )


def actions(browser):
    return webdriver.ActionChains(browser, duration=50)


def hold(browser, forward: float, left: float) -> None:
    """Take the stick's knob and pull it."""
    pad = browser.find_element("css selector", "[data-arrive-pad]")
    # A pad that is cut off by the window would be taken at the middle of what is seen of it.
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", pad)
    offset = (round(-STICK_TRAVEL_PX * left), round(-STICK_TRAVEL_PX * forward))
    actions(browser).move_to_element(pad).click_and_hold().move_by_offset(*offset).perform()


def pixel(stage: Stage, browser, point: tuple[float, float, float]) -> tuple[int, int]:
    """Where a browser shows a point of the world, on the page [px]."""
    (client,) = stage.server.get_clients().values()
    camera, box = client.camera, canvas_box(browser)
    ahead = camera.look_at - camera.position
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    way = np.array(point) - camera.position
    scale = box[3] / 2 / math.tan(camera.fov / 2) / (way @ ahead)
    down = np.cross(ahead, right)
    return round(box[0] + box[2] / 2 + scale * (way @ right)), round(box[1] + box[3] / 2 + scale * (way @ down))


def do(stage: Stage, change: Callable[[Playground], None]) -> None:
    """Do something in the session's thread and wait until it is done."""
    done = threading.Event()
    stage.session.post(lambda playground: (change(playground), done.set()))
    wait_until(done.is_set, "a change in the session's thread")


def wait_until_let_go(stage: Stage) -> None:
    """Wait until the stick is in its middle and the robot stops. One that is put back stops in any case."""
    wait_until(lambda: stage.session._panel._stick.value == CENTRE, "the stick in its middle")
    wait_until(lambda: stage.playground.command.mode == "stop", "the robot stopping")


@pytest.fixture(scope="module")
def stage(tmp_path_factory) -> Iterator[Stage]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "DRAW_PERIOD_S", 0.25)
        stage = Stage(tmp_path_factory.mktemp("browsers"))
        try:
            stage.open_page()
            yield stage
        finally:
            stage.close()


@pytest.fixture
def browser(stage):
    """The first browser; the robot stands at the start on flat ground."""
    do(stage, lambda playground: playground.change(playground.skill, ground_of("flat")))
    wait_until_let_go(stage)
    return stage.browsers[0]


def test_the_page_shows_the_robot_and_its_status(browser):
    shown = picture(browser)
    assert shown.reshape(-1, 3).std(axis=0).min() > 10.0, "the canvas is not uniform"
    for word in ("Waiting", "flat ground", "Plots", "Go (G)", "Slow motion (M)", "Reset (R)", "Policy", "Terrain"):
        assert word in text(browser)


def press(browser, label: str) -> None:
    """Press a button by what stands on it."""
    browser.find_element("xpath", f"//button[.//*[text()='{label}']]").click()


def test_go_sends_the_robot_to_the_drawn_target(stage, browser):
    assert stage.playground.target is None
    press(browser, "Go (G)")
    wait_until(lambda: stage.playground.target, "the target")
    assert stage.playground.target.position_w[:2] == pytest.approx((5.0, 0.0))


def test_slow_motion_can_be_switched(stage, browser):
    press(browser, "Slow motion (M)")
    wait_until(lambda: stage.session.pace.factor == 0.2, "slow motion")
    press(browser, "Slow motion (M)")
    wait_until(lambda: stage.session.pace.factor == 1.0, "real time")


def test_a_click_on_the_ground_sends_the_robot_there(stage, browser):
    x, y = pixel(stage, browser, (1.5, -0.8, 0.0))
    click = actions(browser)
    click.w3c_actions.pointer_action.move_to_location(x, y).click()
    click.perform()
    wait_until(lambda: stage.playground.target, "the target")
    assert stage.playground.target.position_w[:2] == pytest.approx((1.5, -0.8), abs=0.1)
    wait_until(lambda: stage.playground.robot.base_pos_w[0] > 0.3, "the robot on its way")


def test_the_target_can_be_dragged(stage, browser):
    stage.session.post(lambda playground: playground.send(1.5, 0.0, 5.0))
    wait_until(lambda: stage.playground.target, "the target")
    first, height = stage.playground.target, stage.playground.target.position_w[2]
    start, end = (pixel(stage, browser, (x, 0.0, height)) for x in (1.95, 1.25))
    wait_until(lambda: is_red(browser, start), "the target's arrow in the picture")
    drag = actions(browser)
    pointer = drag.w3c_actions.pointer_action
    pointer.move_to_location(*start).pointer_down()
    for share in (0.3, 0.6, 1.0):
        pointer.move_to_location(*(round(a + share * (b - a)) for a, b in zip(start, end, strict=True)))
    pointer.pointer_up()
    drag.perform()
    wait_until(lambda: stage.playground.target is not first, "the target elsewhere")
    x, y, z = stage.playground.target.position_w
    assert 0.4 < x < 1.2
    assert (y, z) == pytest.approx((0.0, height), abs=1e-3)


def test_terrain_and_value_change(stage, browser):
    before = picture(browser)
    choice = next(
        element
        for element in browser.find_elements("css selector", "input")
        if element.get_attribute("value") == "flat"
    )
    choice.click()
    options = lambda: browser.find_elements("xpath", "//*[@role='option'][.='gap']")  # noqa: E731
    wait_until(lambda: any(option.is_displayed() for option in options()), "the list of terrains")
    browser.execute_script("arguments[0].click()", options()[0])
    wait_until(lambda: stage.playground.ground.family.name == "gap", "the terrain")
    values = lambda: browser.find_elements("xpath", "//label[.='Width [m]']/following::input[@type='text'][1]")  # noqa: E731
    wait_until(values, "the field for the width")
    values()[0].send_keys("\b\b\b\b0.5\n")
    wait_until(lambda: stage.playground.ground.value == pytest.approx(0.5), "the value")
    wait_until(lambda: "a gap to leap over, width 0.5 m" in text(browser), "the ground in words")
    wait_until(lambda: np.abs(picture(browser) - before).mean() > 5.0, "other ground in the picture")


def test_the_stick_drives_until_it_is_released(stage, browser):
    hold(browser, 0.6, 0.0)
    wait_until(lambda: stage.playground.command.mode == "joystick", "the stick")
    # The camera looks along the way: away from the person.
    wait_until(lambda: stage.playground.robot.base_pos_w[:2].sum() > 0.7, "the robot on its way")
    actions(browser).release().perform()
    wait_until_let_go(stage)


def test_arrow_keys_drive_and_leave_the_camera_alone(stage, browser):
    (client,) = stage.server.get_clients().values()
    camera = client.camera.position
    actions(browser).key_down("\ue013").perform()
    wait_until(lambda: stage.playground.robot.base_pos_w[:2].sum() > 0.5, "the robot on its way")
    actions(browser).key_up("\ue013").perform()
    wait_until_let_go(stage)
    np.testing.assert_array_equal(client.camera.position, camera)


def test_a_gamepad_in_the_browser_drives(stage, browser):
    pad = "window.asked = 0;navigator.getGamepads = () => (window.asked++, [null, { connected: true, axes: [%s, %s] }])"
    browser.execute_script(pad % (0.05, -0.05))
    wait_until(lambda: browser.execute_script("return window.asked") > 4, "the page asking for gamepads")
    assert CENTRE in inputs(browser), "a stick is never exactly in its middle"
    browser.execute_script(pad % (0.0, -0.7))
    wait_until(lambda: stage.playground.robot.base_pos_w[:2].sum() > 0.5, "the robot on its way")
    browser.execute_script("navigator.getGamepads = () => []")
    wait_until_let_go(stage)


def test_two_browsers_share_the_robot_and_a_reload_keeps_it(stage, browser):
    stage.session.post(lambda playground: playground.change(playground.skill, ground_of("pit=0.1")))
    other = stage.open_page()
    hold(other, 0.0, 0.6)
    wait_until(lambda: stage.playground.command.mode == "joystick", "the stick of the second browser")
    for page in (browser, other):
        wait_until(lambda page=page: "Driven" in text(page), "what the robot does, in both browsers")
    pulled = stage.session._panel._stick.value
    assert parse_stick(pulled) == pytest.approx((0.0, 0.6), abs=0.03)
    wait_until(lambda: inputs(browser).count(pulled) == 1, "the second browser's stick in the first")
    other.quit()
    stage.browsers.remove(other)
    wait_until(lambda: stage.playground.command.mode == "stop", "the stick of a browser that is gone let go")
    # Into the picture again: how far it has walked depends on how busy the machine is.
    do(stage, lambda playground: playground.reset())
    clock = stage.playground.time_s
    browser.refresh()
    wait_for_page(browser)
    wait_until(lambda: "a pit to climb out of" in text(browser), "the same ground")
    assert stage.playground.time_s > clock
    assert len(stage.server.get_clients()) == 1


def test_a_phone_shows_the_robot_and_the_stick(stage, browser):
    phone = stage.open_page(390, 844)
    try:
        bar = phone.find_element("css selector", "[data-arrive-bar]")
        assert bar.is_displayed()
        wait_until(lambda: covered(phone) < 0.1, "the sheet closed, as it is at first")
        bar.find_element("xpath", ".//button[.='Go']").click()
        wait_until(lambda: stage.playground.target, "the target")
        hold(phone, 0.6, 0.0)
        wait_until(lambda: stage.playground.command.mode == "joystick", "the stick")
    finally:
        phone.quit()
        stage.browsers.remove(phone)
