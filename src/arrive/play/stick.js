// Combines the on-screen stick, the arrow keys and a gamepad into one direction. It runs in the page, because viser has
// no stick and does not report released keys. It writes "FORWARD LEFT", each -1 to 1, into the text field "Stick". The
// server only reads this field.
(function (pad) {
  const REACH = 46; // travel of the knob [px]
  const PERIOD_MS = 50;
  const DEAD_ZONE = 0.1; // of a gamepad's stick, because its centre is never exactly 0
  const WRITTEN = /^-?\d\.\d\d -?\d\.\d\d$/;
  const ARROWS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] };

  function textField() {
    return [...document.querySelectorAll("input")].find((input) => WRITTEN.test(input.value));
  }

  // Hide the text field, which is only for the server.
  function hideRow(field) {
    let row = field;
    while (row && !row.textContent.trim()) row = row.parentElement;
    if (row && row.textContent.trim() === "Stick") row.style.display = "none";
  }

  // React only notices a value that is set by the element's own setter and followed by an event.
  function write(field, text) {
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(field, text);
    field.dispatchEvent(new Event("input", { bubbles: true }));
  }

  function shared() {
    const state = { pointer: [0, 0], keys: new Map(), slow: false, last: "0.00 0.00" };
    const inForm = (target) => target.closest && target.closest("input, textarea, select, [role=slider]");
    const onKey = (event, down) => {
      state.slow = event.shiftKey;
      if (!(event.code in ARROWS) || (down && inForm(event.target))) return;
      if (down) state.keys.set(event.code, ARROWS[event.code]);
      else state.keys.delete(event.code);
      // Otherwise the arrow keys would also turn the camera.
      if (!inForm(event.target)) event.stopImmediatePropagation();
    };
    window.addEventListener("keydown", (event) => onKey(event, true), true);
    window.addEventListener("keyup", (event) => onKey(event, false), true);
    window.addEventListener("blur", () => state.keys.clear());
    setInterval(() => send(state), PERIOD_MS);
    return state;
  }

  function gamepad() {
    const found = [...(navigator.getGamepads ? navigator.getGamepads() : [])].find((pad) => pad && pad.connected);
    if (!found) return [0, 0];
    const direction = [-found.axes[1], -found.axes[0]];
    return Math.hypot(...direction) < DEAD_ZONE ? [0, 0] : direction;
  }

  function direction(state) {
    const pressed = [...state.keys.values()];
    const share = state.slow ? 0.5 : 1;
    const keys = [0, 1].map((axis) => share * pressed.reduce((sum, key) => sum + key[axis], 0));
    const sum = [0, 1].map((axis) => state.pointer[axis] + keys[axis] + gamepad()[axis]);
    const size = Math.max(1, Math.hypot(...sum));
    return sum.map((value) => value / size);
  }

  function send(state) {
    const field = textField();
    if (!field) return;
    hideRow(field);
    showStatus();
    const text = direction(state).map((value) => (Math.round(value * 50) / 50 || 0).toFixed(2)).join(" ");
    // Only write changes of this browser: another one may be driving.
    if (text !== state.last) write(field, text);
    state.last = text;
    const [forward, left] = field.value.split(" ").map(Number);
    const knob = document.querySelector("[data-arrive-knob]");
    if (knob) knob.setAttribute("transform", `translate(${-REACH * left} ${-REACH * forward})`);
  }

  // On a phone the panel with the status is closed, so a copy of the status is shown over the picture.
  function showStatus() {
    const sign = document.querySelector("[data-arrive-sign]");
    const said = document.querySelector("[data-arrive-status]:not([data-arrive-sign] *)");
    if (sign && said && sign.innerHTML !== said.outerHTML) sign.innerHTML = said.outerHTML;
  }

  // On a phone viser's panel covers the picture. So close it at first, and put stick and buttons over the picture.
  function phoneLayout(pad) {
    document.querySelectorAll("[data-arrive-bar], [data-arrive-sign]").forEach((part) => part.remove());
    if (!matchMedia("(max-width: 36em)").matches) return;
    const bar = document.createElement("div");
    bar.dataset.arriveBar = "";
    const keys = document.createElement("div");
    for (const label of ["Go", "Slow motion", "Reset"]) {
      const key = document.createElement("button");
      key.textContent = label;
      key.onclick = () => {
        const own = [...document.querySelectorAll("button[id]")].find((b) => b.textContent.startsWith(`${label} (`));
        if (own) own.click();
      };
      keys.append(key);
    }
    bar.append(pad, keys);
    const sign = document.createElement("div");
    sign.dataset.arriveSign = "";
    document.body.append(bar, sign);
    const handle = document.querySelector('[style*="cursor: pointer"][style*="height: 3.5em"]');
    // Only once, so that it stays open if the user opens it. The page may be built twice before it has a panel.
    if (!handle || window.arriveSheet) return;
    handle.click();
    window.arriveSheet = true;
  }

  const state = (window.arriveStick ??= shared());
  phoneLayout(pad);
  const move = (event) => {
    const box = pad.getBoundingClientRect();
    const x = (event.clientX - box.left - box.width / 2) / REACH;
    const y = (event.clientY - box.top - box.height / 2) / REACH;
    const size = Math.max(1, Math.hypot(x, y));
    state.pointer = [-y / size, -x / size];
  };
  const release = () => (state.pointer = [0, 0]);
  pad.addEventListener("pointerdown", (event) => {
    pad.setPointerCapture(event.pointerId);
    move(event);
  });
  pad.addEventListener("pointermove", (event) => pad.hasPointerCapture(event.pointerId) && move(event));
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) pad.addEventListener(end, release);
})
