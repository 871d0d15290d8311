// An avatar that moves as motion.json says, its clothes computed here. The scene is in glTF's axes.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { loadOutfit } from "./physkin.js";
import { layOn } from "./three.js";

const SHOWN_TIMES = 30; // frames that the time shown is the median of

const find = (id) => document.getElementById(id);

async function start() {
  const began = performance.now();
  const motionFile = fetch("motion.json").then((response) => response.json());
  const [outfit, model, motion] = await Promise.all([
    loadOutfit("outfit.physkin.gz"),
    new GLTFLoader().loadAsync("dressed.glb"),
    motionFile,
  ]);
  const loaded = performance.now() - began;
  const said = `loaded in ${(loaded / 1000).toFixed(2)} s`;
  find("told").textContent = said;
  const stage = new Stage(model.scene);
  const figure = new Figure(outfit, model.scene);
  const player = new Player(motion, outfit);
  addJoints(outfit, player);
  addGarments(outfit, figure);
  find("play").onclick = () => {
    player.playing = !player.playing;
    find("play").textContent = player.playing ? "Pause" : "Play";
  };

  const times = [];
  let last = performance.now();
  function frame(now) {
    const { positions, root, again } = player.after(Math.max(0, now - last) / 1000);
    last = now;
    if (again) outfit.reset();
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
  window.shown = { outfit, player, figure, loaded }; // for who looks from the console
}

/** Light, floor and camera, which follows the figure. */
class Stage {
  #renderer = new THREE.WebGLRenderer({ antialias: true });
  #scene = new THREE.Scene();
  #camera = new THREE.PerspectiveCamera(28, 1, 0.1, 50);
  #controls = new OrbitControls(this.#camera, this.#renderer.domElement);
  #sun = new THREE.DirectionalLight(0xffffff, 1.8);
  #at = new THREE.Vector3();

  constructor(figure) {
    this.#renderer.shadowMap.enabled = true;
    this.#renderer.shadowMap.type = THREE.PCFSoftShadowMap;
    document.body.prepend(this.#renderer.domElement);
    this.#scene.background = new THREE.Color(0xeeeeee);
    const floor = new THREE.Mesh(new THREE.CircleGeometry(20, 64), new THREE.ShadowMaterial({ opacity: 0.25 }));
    floor.rotation.x = -Math.PI / 2;
    floor.receiveShadow = true;
    this.#sun.castShadow = true;
    this.#sun.shadow.mapSize.set(2048, 2048);
    Object.assign(this.#sun.shadow.camera, { left: -1.5, right: 1.5, top: 1.5, bottom: -1.5, far: 12 });
    this.#sun.shadow.normalBias = 0.01;
    this.#scene.add(floor, this.#sun, this.#sun.target, new THREE.HemisphereLight(0xffffff, 0xc0b0a0, 2.2), figure);
    this.#camera.position.set(1.4, 0.5, 4.2);
    this.#controls.enableDamping = true;
    const fit = () => {
      this.#renderer.setSize(innerWidth, innerHeight);
      this.#camera.aspect = innerWidth / innerHeight;
      this.#camera.updateProjectionMatrix();
    };
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    addEventListener("resize", fit);
    fit();
  }

  draw(root) {
    const at = new THREE.Vector3(...root);
    this.#camera.position.add(at).sub(this.#at);
    this.#controls.target.copy(at);
    this.#at.copy(at);
    this.#sun.position.copy(at).add(new THREE.Vector3(2, 4, 3));
    this.#sun.target.position.copy(at);
    this.#controls.update();
    this.#renderer.render(this.#scene, this.#camera);
  }
}

/** The avatar on its bones, and meshes that lie on the garments. */
class Figure {
  #outfit;
  #model;
  #bones;
  #lay = [];
  #meshes = [];

  constructor(outfit, model) {
    this.#outfit = outfit;
    this.#model = model;
    this.#bones = new Map(outfit.bones.map(({ name }) => [name, boneOf(model, name)]));
    model.traverse((mesh) => {
      if (!mesh.isMesh) return;
      mesh.castShadow = mesh.receiveShadow = true;
      mesh.frustumCulled = false;
      const garment = mesh.userData.garment ?? mesh.parent.userData.garment;
      const covered = mesh.userData.covered ?? mesh.parent.userData.covered;
      this.#meshes.push({ mesh, garment, covered });
      if (garment !== undefined) this.#lay.push(layOn(mesh, outfit.garments[garment]));
    });
    this.wear(() => true);
  }

  /** Shows garments that `worn` says, and skin that no garment covers then. */
  wear(worn) {
    const all = this.#outfit.garments.every((_, garment) => worn(garment));
    for (const { mesh, garment, covered } of this.#meshes) {
      mesh.visible = garment === undefined ? !(covered && all) : worn(garment);
    }
  }

  show(positions, [x, y, z, ...turn]) {
    this.#model.position.set(x, y, z);
    this.#model.quaternion.fromArray(turn);
    for (const [name, rotation] of this.#outfit.boneRotations(positions)) {
      this.#bones.get(name)?.quaternion.fromArray(rotation);
    }
    for (const lay of this.#lay) lay();
  }
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
    const share = this.#time * rate - first;
    const between = (values) => values[first].map((value, at) => value + share * (values[next][at] - value));
    const [x, y, z] = between(root);
    const turn = new THREE.Quaternion(...root[first].slice(3)).slerp(new THREE.Quaternion(...root[next].slice(3)), share);
    return {
      positions: between(positions).map((position, joint) => position + this.added[joint]),
      root: [x, y, z, ...turn.toArray()],
      again,
    };
  }
}

// GLTFLoader leaves dots out of the names of nodes, and keeps them as they were beside.
function boneOf(model, name) {
  let found;
  model.traverse((node) => {
    if (node.isBone && (node.userData.name ?? node.name) === name) found = node;
  });
  return found;
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

start().catch((error) => {
  find("told").textContent = "";
  find("wrong").textContent = error.message;
  throw error;
});
