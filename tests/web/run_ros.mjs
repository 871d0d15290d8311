// What the module makes of what a rosbridge publishes: node run_ros.mjs PACKAGE ADDRESS CASE, answers as JSON.
//   CASE: { mesh, nodes }, fields that replace those of the first garment's messages: its error is told; else all
//   garments of the first frame.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [folder, address, text] = process.argv.slice(2);
const { Ros, Topic } = await import(pathToFileURL(`${folder}/node_modules/roslib/dist/RosLib.js`).href);
const { garmentTopics, GarmentClient, GarmentSkin } = await import(pathToFileURL(`${folder}/ros.js`).href);
const { PhyskinError } = await import(pathToFileURL(`${folder}/native_module.js`).href);
const given = JSON.parse(text, (_, value) => (value === "NaN" ? NaN : value));
const wasm = await WebAssembly.compile(readFileSync(`${folder}/physkin.wasm`));

const ros = new Ros({ url: address });
await new Promise((resolve, reject) => (ros.on("connection", resolve), ros.on("error", reject)));
const garments = await garmentTopics(ros);
const base64 = ({ buffer }) => Buffer.from(buffer).toString("base64");

function drapedOf(topics) {
  return new Promise((resolve, reject) => {
    const client = new GarmentClient(ros, topics, {
      wasm,
      onError: reject,
      onFrame: ({ name, faces, positions, normals }) => {
        client.close();
        resolve({ topics, name, faces: Array.from(faces), positions: base64(positions), normals: base64(normals) });
      },
    });
  });
}

const messageOf = (name, messageType) =>
  new Promise((resolve) => new Topic({ ros, name, messageType, compression: "cbor" }).subscribe(resolve));

async function refused() {
  const mesh = await messageOf(`${garments[0]}/mesh`, "physkin_msgs/msg/GarmentMesh");
  const nodes = await messageOf(`${garments[0]}/garment_nodes`, "physkin_msgs/msg/GarmentNodes");
  try {
    const skin = await GarmentSkin.of({ ...mesh, ...given.mesh }, { wasm });
    skin.skin({ ...nodes, ...given.nodes });
  } catch (error) {
    return { ours: error instanceof PhyskinError, message: error.message };
  }
}

const changed = given.mesh !== undefined || given.nodes !== undefined;
const answer = changed ? await refused() : await Promise.all(garments.map(drapedOf));
process.stdout.write(JSON.stringify(answer), () => process.exit(0));
