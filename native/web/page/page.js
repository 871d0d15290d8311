// An avatar that moves as motion.json says, its clothes computed here; or, with ?bridge=ws://HOST:9090, as a running ROS
// node poses both; or as who sits before the camera, unless with ?camera=no. The scene is in glTF's axes.
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { showBridge } from "./live.js";
import { loadOutfit } from "./physkin.js";
import { Figure, poseBetween, Stage } from "./stage.js";

const SHOWN_TIMES = 30; // frames that the time shown is the median of

const find = (id) => document.getElementById(id);
const asked = new URLSearchParams(location.search);
const bridge = asked.get("bridge");

async function start() {
  const began = performance.now();
  const [outfit, model, motion] = await Promise.all([
    loadOutfit("outfit.physkin.gz"),
    new GLTFLoader().loadAsync("dressed.glb"),
    fetch("motion.json").then((response) => response.json()),
  ]);
  const loaded = performance.now() - began;
  const said = `loaded in ${(loaded / 1000).toFixed(2)} s`;
  find("told").textContent = said;
  outfit.wind = motion.wind;
  const stage = new Stage(model.scene);
  const figure = new Figure(outfit, model.scene);
  if (bridge !== null) {
    find("player").remove();
    const say = (text) => (find("told").textContent = text);
    const root = [...motion.root[0].slice(0, 3), 0, 0, 0, 1];
    window.shown = await showBridge(bridge, { stage, figure, outfit, root, say });
    return;
  }
  const player = new Player(motion, outfit);
  let camera = null;
  if (motion.camera !== undefined && asked.get("camera") !== "no") {
    addCamera(outfit, motion.camera, (opened) => (camera = window.shown.camera = opened));
  }
  addJoints(outfit, player);
  addGarments(outfit, figure);
  addFabrics(outfit);
  find("play").onclick = () => {
    player.playing = !player.playing;
    find("play").textContent = player.playing ? "Pause" : "Play";
  };

  const times = [];
  let last = performance.now();
  let lived = null; // of the frame before
  function frame(now) {
    const live = camera?.now() ?? null;
    const { positions, root, again } = live ?? player.after(camera ? 0 : Math.max(0, now - last) / 1000);
    last = now;
    if (again || (live === null) !== (lived === null)) outfit.reset();
    lived = live;
    const before = performance.now();
    outfit.step(positions, { time: now / 1000, root });
    times.push(performance.now() - before);
    figure.show(positions, root);
    stage.draw(root);
    if (times.length === SHOWN_TIMES) {
      const median = times.sort((a, b) => a - b)[SHOWN_TIMES / 2];
      find("told").textContent = `cloth: ${median.toFixed(2)} ms a frame; ${said}`;
      times.length = 0;
    }
    requestAnimationFrame(frame);
  }
  requestAnimationFrame(frame);
  window.shown = { outfit, player, figure, stage, loaded }; // for who looks from the console
}

/** Joint positions and root of any moment of the motion, and what sliders add to it. */
class Player {
  playing = true;
  #motion;
  #time = 0;

  constructor(motion, outfit) {
    this.#motion = motion;
    this.added = new Float32Array(outfit.joints.length);
  }

  /** So many seconds later; again: whether the motion began anew. */
  after(seconds) {
    const { rate, positions, root } = this.#motion;
    const length = Math.max(positions.length - 1, 1) / rate;
    this.#time += this.playing ? seconds : 0;
    const again = this.#time >= length;
    this.#time %= length;
    const first = Math.min(Math.floor(this.#time * rate), positions.length - 1);
    const next = Math.min(first + 1, positions.length - 1);
    const ends = [first, next].map((frame) => ({ positions: positions[frame], root: root[frame] }));
    const pose = poseBetween(...ends, this.#time * rate - first);
    return { ...pose, positions: pose.positions.map((position, joint) => position + this.added[joint]), again };
  }
}

/** scale: of the avatar's legs. use: is given the camera when it opens, and null when it is closed. */
function addCamera(outfit, scale, use) {
  let camera = null;
  const button = find("camera");
  const say = (text) => (find("seen").textContent = text);
  find("live").hidden = false;
  button.onclick = async () => {
    button.disabled = true;
    const { Camera } = await import("./camera.js");
    if (camera !== null) camera = camera.close() ?? null;
    else camera = await Camera.open(find("picture"), outfit, scale, say).catch((error) => say(error.message) && null);
    use(camera);
    find("picture").hidden = camera === null;
    button.textContent = camera === null ? "Camera" : "Camera off";
    button.disabled = false;
  };
}

function addJoints(outfit, player) {
  const sliders = outfit.joints.map(({ name, lower, rest, upper }, joint) => {
    const slider = Object.assign(document.createElement("input"), { type: "range", step: "any" });
    Object.assign(slider, { min: lower - rest, max: upper - rest, value: 0 });
    slider.oninput = () => (player.added[joint] = slider.valueAsNumber);
    const label = Object.assign(document.createElement("label"), { className: "joint", textContent: name });
    label.append(slider);
    find("joints").append(label);
    return slider;
  });
  find("rest").onclick = () => {
    sliders.forEach((slider) => (slider.value = 0));
    player.added.fill(0);
  };
}

function addGarments(outfit, figure) {
  if (outfit.garments.length < 2) return;
  const boxes = outfit.garments.map(({ name }) => {
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: true });
    box.onchange = () => figure.wear((garment) => boxes[garment].checked);
    const label = document.createElement("label");
    label.append(box, name);
    find("garments").append(label);
    return box;
  });
}

function addFabrics(outfit) {
  for (const garment of outfit.garments) {
    if (garment.fabrics.length < 2) continue;
    const choice = document.createElement("select");
    choice.append(...garment.fabrics.map((name) => new Option(name)));
    choice.onchange = () => (garment.fabric = choice.value);
    const label = Object.assign(document.createElement("label"), { textContent: `${garment.name} hangs as` });
    label.append(choice);
    find("fabrics").append(label);
  }
}

start().catch((error) => {
  find("told").textContent = "";
  find("wrong").textContent = error.message;
  throw error;
});
