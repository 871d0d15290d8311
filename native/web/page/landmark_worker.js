// Landmarks of a person in a picture, by @mediapipe/pose beside this page, in a thread of its own: a picture (ImageBitmap)
// in; { landmarks: [{ x, y, z, visibility }, ...] or null, ms } out. Metres; x right, y down, z away from the camera.

// The package asks for a page's window and scripts: its own code for workers loads models as scripts.
const canvas = () => new OffscreenCanvas(1, 1);
const script = () => ({
  setAttribute(name, value) {
    this[name] = value;
  },
  addEventListener(name, listener) {
    this[name] = listener;
  },
});
self.window = self;
self.document = {
  addEventListener() {},
  createElement: (tag) => (tag === "canvas" ? canvas() : script()),
  body: {
    appendChild(added) {
      importScripts(added.src);
      added.load();
    },
  },
};
importScripts("mediapipe/pose.js");

let found = null;
const pose = new Pose({ locateFile: (name) => new URL(`mediapipe/${name}`, location).href });
pose.setOptions({ modelComplexity: 0, smoothLandmarks: false, useCpuInference: true }); // the GPU draws
pose.onResults(({ poseWorldLandmarks }) => (found = poseWorldLandmarks ?? null));

onmessage = async ({ data: image }) => {
  const before = performance.now();
  try {
    await pose.send({ image });
    const landmarks = found?.map(({ x, y, z, visibility }) => ({ x, y, z, visibility })) ?? null;
    postMessage({ landmarks, ms: performance.now() - before });
  } catch (error) {
    postMessage({ error: `landmarks cannot be found: ${error.message ?? error}` });
  }
  image.close();
};
