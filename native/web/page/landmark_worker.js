// Landmarks of a person in a picture, by @mediapipe/pose beside this page, in a thread of its own: an ImageBitmap in,
// { landmarks: [{ x, y, z, visibility }, ...] or null, others: whether there are, ms } out. Metres; x right, y down, z away
// from the camera.

// The package takes this thread for a page: what it does in workers loads its models as scripts.
const set = function (name, value) {
  this[name] = value;
};
self.window = self;
self.document = {
  addEventListener() {},
  createElement: (tag) => (tag === "canvas" ? new OffscreenCanvas(1, 1) : { setAttribute: set, addEventListener: set }),
  body: { appendChild: ({ src, load }) => load(importScripts(src)) },
};
importScripts("mediapipe/pose.js");

const EVERY = 2000; // [ms] in which others are looked for
const BREADTH = 0.6; // of what is painted over along limbs, as a share of the trunk's length

let [person, other, others, looked] = [{}, {}, false, 0];
const finder = newFinder((found) => (person = found));
const finderOfOthers = newFinder((found) => (other = found)); // of one who is left when the person is painted over
const canvas = new OffscreenCanvas(1, 1);

function newFinder(take) {
  const pose = new Pose({ locateFile: (name) => new URL(`mediapipe/${name}`, location).href });
  pose.setOptions({ modelComplexity: 0, smoothLandmarks: false, useCpuInference: true }); // the GPU draws
  pose.onResults(take);
  return pose;
}

async function lookForOthers(image, at) {
  const { width, height } = Object.assign(canvas, { width: image.width, height: image.height });
  const breadth = BREADTH * Math.abs(at[11].y - at[23].y); // left shoulder to hip
  const brush = canvas.getContext("2d");
  brush.drawImage(image, 0, 0);
  brush.scale(width, height);
  Object.assign(brush, { lineCap: "round", lineWidth: breadth, strokeStyle: "grey" });
  for (const ends of POSE_CONNECTIONS) ends.forEach((end, last) => brush[last ? "lineTo" : "moveTo"](at[end].x, at[end].y));
  brush.stroke();
  await finderOfOthers.send({ image: canvas });
  const middles = [at, other.poseLandmarks ?? at].map((points) => (points[11].x + points[24].x) / 2);
  others = Math.abs(middles[0] - middles[1]) > breadth; // not the paint itself
}

onmessage = async ({ data: image }) => {
  const before = performance.now();
  try {
    await finder.send({ image });
    const { poseLandmarks: at, poseWorldLandmarks: landmarks = null } = person;
    const ms = performance.now() - before;
    if (!at) others = false;
    else if (before - looked > EVERY) {
      looked = before;
      await lookForOthers(image, at);
    }
    postMessage({ landmarks, others, ms });
  } catch (wrong) {
    postMessage({ error: `landmarks are not found: ${wrong}` });
  }
  image.close();
};
