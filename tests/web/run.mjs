// What the module in JavaScript makes of a case: node run.mjs PACKAGE CASE, both answers and errors as JSON.
//   CASE: { file, frames: [[joints, frame, wind, fabric of all garments, if they change], ...], poses: [{ bone: [x, y, z, w], ... }, ...], vrm }
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [folder, path] = process.argv.slice(2);
const at = (name) => pathToFileURL(`${folder}/${name}`).href;
const { loadOutfit, PhyskinError } = await import(at("physkin.js"));
const { VrmPose } = await import(at("vrm.js"));
const given = JSON.parse(readFileSync(path), (_, value) => (value === "NaN" ? NaN : value));

const told = (work) => {
  try {
    return work();
  } catch (error) {
    return { ours: error instanceof PhyskinError, message: error.message };
  }
};

async function answer() {
  const outfit = await loadOutfit(readFileSync(given.file), { wasm: readFileSync(`${folder}/physkin.wasm`) });
  const clouds = () => outfit.garments.map(({ positions, normals }) => [base64(positions), base64(normals)]);
  const rest = clouds();
  const arrays = outfit.garments.map(({ positions }) => positions);
  const frames = (given.frames ?? []).map(([joints, frame, wind, fabric]) =>
    told(() => {
      if (wind !== undefined && wind !== null) outfit.wind = wind;
      if (fabric !== undefined) outfit.garments.forEach((garment) => (garment.fabric = fabric));
      outfit.step(joints, frame);
      return {
        clouds: clouds(),
        bones: Object.fromEntries(outfit.boneRotations(joints)),
      };
    }),
  );
  const poses = (given.poses ?? []).map((pose) =>
    told(() => {
      const getNormalizedBoneNode = (bone) => {
        const [x, y, z, w] = pose[bone] ?? [];
        return bone in pose ? { quaternion: { x, y, z, w } } : null;
      };
      const vrm = { meta: { metaVersion: given.vrm }, humanoid: { getNormalizedBoneNode } };
      return Array.from(new VrmPose(outfit).of(vrm));
    }),
  );
  return {
    rest,
    joints: outfit.joints,
    garments: outfit.garments.map(({ name, faces, fabric, fabrics }) => ({ name, faces: Array.from(faces), fabric, fabrics })),
    kept: outfit.garments.every(({ positions }, k) => positions === arrays[k] && positions.length > 0),
    frames,
    poses,
  };
}

const base64 = ({ buffer }) => Buffer.from(buffer).toString("base64");
console.log(JSON.stringify(await answer().catch((error) => told(() => { throw error; }))));
