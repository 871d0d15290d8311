// The visitor as the page's motion: landmarks in the camera's picture, found in this tab, as joint positions.
import * as THREE from "three";
import { LandmarkReader } from "./landmarks.js";
import { poseBetween } from "./stage.js";

const PICTURE = { width: 480, height: 360, facingMode: "user" };
const SAID = { seen: "You are seen.", lost: "Nobody is seen: step into the picture." };
const OTHERS = " Somebody else is there, too: one of you is followed.";
const IN_GLTF = [4, 5, 3, 7, 8, 6, 1, 2, 0]; // numbers of a rotation
const LONGEST = 200; // [ms] in which a pose moves on to the next

/** An open camera, whose poses move on evenly between landmarks. */
export class Camera {
  #video;
  #reader;
  #scale;
  #say;
  #worker = new Worker(new URL("landmark_worker.js", import.meta.url));
  #poses = null; // what was shown when the last landmarks came, and what they say
  #shown = 0; // [ms] when the picture was that is looked at
  #came = 0;
  #between = 1; // [ms] from landmarks to landmarks
  ms = 0; // that landmarks take, of late

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
    return poseBetween(...this.#poses, Math.min((performance.now() - this.#came) / this.#between, 1));
  }

  close() {
    this.#worker.terminate();
    this.#video.srcObject.getTracks().forEach((track) => track.stop());
  }

  #look() {
    this.#video.requestVideoFrameCallback(async (shown) => {
      this.#shown = shown;
      const image = await createImageBitmap(this.#video);
      this.#worker.postMessage(image, [image]);
    });
  }

  #take({ landmarks, others, ms }) {
    const now = performance.now();
    const { positions, height, root } = this.#reader.read(landmarks, this.#shown / 1000);
    const turn = new THREE.Matrix4().setFromMatrix3(new THREE.Matrix3(...IN_GLTF.map((at) => root[at])));
    const quaternion = new THREE.Quaternion().setFromRotationMatrix(turn);
    const pose = { positions, root: [0, this.#scale * height, 0, ...quaternion.toArray()] };
    this.#poses = [this.now() ?? pose, pose];
    [this.#between, this.#came] = [Math.min(now - this.#came, LONGEST), now];
    this.ms = this.ms ? 0.9 * this.ms + 0.1 * ms : ms;
    const { status, lost } = this.#reader;
    const said = SAID[status] ?? `Not seen: ${lost.join(", ")}.`;
    this.#say(`${said}${others ? OTHERS : ""} Landmarks: ${this.ms.toFixed(0)} ms.`);
    this.#look();
  }
}
