// What is drawn: a stage, and the avatar on it with meshes that lie on garments.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { layOn } from "./three.js";

/** Light, floor and camera, which follows the figure. */
export class Stage {
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

/** A share of the way from a pose to the next: joint positions and roots. */
export function poseBetween(from, to, share) {
  const mix = (values, next) => values.map((value, at) => value + share * (next[at] - value));
  const [turn, last] = [from, to].map(({ root }) => new THREE.Quaternion(...root.slice(3)));
  const root = [...mix(from.root.slice(0, 3), to.root), ...turn.slerp(last, share).toArray()];
  return { positions: mix(from.positions, to.positions), root };
}

/** The avatar on its bones, and meshes that lie on the garments. */
export class Figure {
  model;
  #outfit;
  #bones;
  #lay = [];
  #meshes = [];

  constructor(outfit, model) {
    this.#outfit = outfit;
    this.model = model;
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

  /** Shows garments that `worn` says, and skin that nothing covers then: `covered`, whether all is worn. */
  wear(worn, covered = this.#outfit.garments.every((_, garment) => worn(garment))) {
    for (const { mesh, garment, covered: below } of this.#meshes) {
      mesh.visible = garment === undefined ? !(below && covered) : worn(garment);
    }
  }

  /** A plain material of the colour that the outfit's garment of this name has on average; grey for another. */
  clothOf(name) {
    const garment = this.#outfit.garments.findIndex((each) => each.name === name);
    const found = this.#meshes.find((each) => each.garment === garment)?.mesh.material;
    const color = new THREE.Color(found?.color ?? 0x8899aa);
    if (found?.map) color.multiply(meanColor(found.map.image));
    return new THREE.MeshStandardMaterial({ color, roughness: 0.9, side: THREE.DoubleSide });
  }

  show(positions, [x, y, z, ...turn]) {
    this.model.position.set(x, y, z);
    this.model.quaternion.fromArray(turn);
    for (const [name, rotation] of this.#outfit.boneRotations(positions)) {
      this.#bones.get(name)?.quaternion.fromArray(rotation);
    }
    for (const lay of this.#lay) lay();
  }
}

function meanColor(image) {
  const canvas = new OffscreenCanvas(1, 1).getContext("2d");
  canvas.drawImage(image, 0, 0, 1, 1);
  const [red, green, blue] = canvas.getImageData(0, 0, 1, 1).data;
  return new THREE.Color().setRGB(red / 255, green / 255, blue / 255, THREE.SRGBColorSpace);
}

// GLTFLoader leaves dots out of the names of nodes, and keeps them as they were beside.
function boneOf(model, name) {
  let found;
  model.traverse((node) => {
    if (node.isBone && (node.userData.name ?? node.name) === name) found = node;
  });
  return found;
}
