// Frames of landmarks through landmarks.js: node run_landmarks.mjs FOLDER CASE, what it reads of each as JSON.
//   CASE: { table, joints, frames: [[time, [[x, y, z, visibility], ...] or null], ...] }
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [folder, path] = process.argv.slice(2);
const { LandmarkReader } = await import(pathToFileURL(`${folder}/landmarks.js`).href);
const { table, joints, frames } = JSON.parse(readFileSync(path));
const reader = new LandmarkReader(table, joints);
const read = frames.map(([time, points]) => {
  const pose = reader.read(points && points.map(([x, y, z, visibility]) => ({ x, y, z, visibility })), time);
  return { ...pose, status: reader.status, lost: reader.lost };
});
console.log(JSON.stringify(read));
