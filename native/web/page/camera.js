// The visitor as the page's motion: landmarks in the camera's picture, found in this tab, as joint positions.
import * as THREE from "three";
import { LandmarkReader } from "./landmarks.js";

const PICTURE = { width: 480, height: 360, facingMode: "user" };
const SAID = { seen: "You are seen.", lost: "Nobody is seen: step into the picture." };
const COUNTED = 30; // landmark frames whose time is said
const LONGEST = 200; // [ms] in which a pose moves on to the next

/** An open camera, whose poses move on evenly between landmarks. */
export class Camera {
  #video;
  #reader;
  #scale;
  #say;
  #worker = new Worker(new URL("landmark_worker.js", import.meta.url));
  #poses = null; // what was shown when the last landmarks came, and what they say
  #came = 0;
  #between = 1; // [ms] from landmarks to landmarks
  times = []; // [ms] that landmarks took

  /** video: shows the picture. scale: of the avatar's legs to the default's. say: is told what is seen. Throws where
   * there is no camera, or the visitor does not allow it. */
  static async open(video, outfit, scale, say) {
    if (!navigator.mediaDevices) throw new Error("browsers lend a camera to https:// and localhost pages only");
    const table = await (await fetch("camera.json")).json();
    video.srcObject = await navigator.mediaDevices.getUserMedia({ video: PICTURE });
    await video.play();
    say("Finding you …");
    return new Camera(video, new LandmarkReader(table, outfit.joints), scale, say);
  }

  /** @private */
  constructor(video, reader, scale, say) {
    [this.#video, this.#reader, this.#scale, this.#say] = [video, reader, scale, say];
    this.#worker.onmessage = ({ data }) => (data.error === undefined ? this.#take(data) : say(data.error));
    this.#worker.onerror = ({ message }) => say(message);
    this.#look();
  }

  /** Joint positions and root at this moment; null until the first landmarks come. */
  now() {
    if (this.#poses === null) return null;
    const share = Math.min((performance.now() - this.#came) / this.#between, 1);
    const [from, to] = this.#poses;
    const mix = (values, next) => values.map((value, at) => value + share * (next[at] - value));
    const [turn, last] = [from, to].map(({ root }) => new THREE.Quaternion(...root.slice(3)));
    const root = [...mix(from.root.slice(0, 3), to.root), ...turn.slerp(last, share).toArray()];
    return { positions: mix(from.positions, to.positions), root };
  }

  close() {
    this.#worker.terminate();
    this.#video.srcObject.getTracks().forEach((track) => track.stop());
  }

  #look() {
    this.#video.requestVideoFrameCallback(async () => {
      const image = await createImageBitmap(this.#video);
      this.#worker.postMessage(image, [image]);
    });
  }

  #take({ landmarks, ms }) {
    const now = performance.now();
    const pose = this.#reader.read(landmarks, now / 1000);
    pose.root = pose.root.map((value, at) => (at < 3 ? this.#scale * value : value));
    this.#poses = [this.now() ?? pose, pose];
    [this.#between, this.#came] = [Math.min(now - this.#came, LONGEST), now];
    this.times = [...this.times, ms].slice(-COUNTED);
    const { status, lost } = this.#reader;
    const took = this.times.reduce((a, b) => a + b) / this.times.length;
    this.#say(`${SAID[status] ?? `Not seen: ${lost.join(", ")}.`} Landmarks: ${took.toFixed(0)} ms.`);
    this.#look();
  }
}
