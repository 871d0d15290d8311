// A running ROS node in place of the page's own motion: the body follows its joint states, cloth its garment nodes.
import * as THREE from "three";
import { Ros, Topic } from "roslib";
import { GarmentClient, garmentTopics } from "./ros.js";
import { garmentGeometry, refresh } from "./three.js";

/** Shows what the node behind a rosbridge drapes, standing at `root`; `say` is told how it fares, once a second. Throws where it cannot be
 * reached, or nothing is draped. */
export async function showBridge(address, { stage, figure, outfit, root, say }) {
  const ros = await connected(address);
  const garments = await garmentTopics(ros);
  if (garments.length === 0) throw new Error(`nobody publishes garment meshes behind ${address}`);
  const joints = Object.fromEntries(outfit.joints.map(({ name, rest }) => [name, rest]));
  const states = new URLSearchParams(location.search).get("joint_states") ?? "/joint_states";
  const type = "sensor_msgs/msg/JointState";
  new Topic({ ros, name: states, messageType: type, compression: "cbor" }).subscribe(({ name, position }) => {
    name.forEach((joint, at) => joint in joints && (joints[joint] = position[at]));
  });
  const shown = { frames: 0, worn: new Map() };
  for (const topics of garments) {
    let mesh = null;
    new GarmentClient(ros, topics, {
      onMesh(skin) {
        if (mesh !== null) figure.model.remove(mesh);
        mesh = new THREE.Mesh(garmentGeometry(skin), figure.clothOf(skin.name));
        mesh.castShadow = mesh.receiveShadow = true;
        mesh.frustumCulled = mesh.visible = false;
        figure.model.add(mesh);
        shown.worn.set(topics, skin);
        const names = [...shown.worn.values()].map(({ name }) => name);
        figure.wear(() => false, outfit.garments.every(({ name }) => names.includes(name)));
      },
      onFrame() {
        mesh.visible = true;
        refresh(mesh.geometry);
        ++shown.frames;
      },
      onError: ({ message }) => say(message),
    });
  }
  setInterval(() => {
    say(`${[...shown.worn.values()].map(({ name }) => name).join(", ")}: ${shown.frames} frames from ${address}`);
  }, 1000);
  const frame = () => {
    figure.show(joints, root);
    stage.draw(root);
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
  return shown;
}

function connected(url) {
  return new Promise((resolve, reject) => {
    const ros = new Ros({ url });
    ros.on("connection", () => resolve(ros));
    ros.on("error", () => reject(new Error(`no rosbridge answers at ${url}`)));
  });
}
