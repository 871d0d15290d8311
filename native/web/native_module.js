// physkin.wasm and its memory: what Outfit (physkin.js) and GarmentSkin (ros.js) stand on.

const ABI_VERSION = 4;

/** Numbers of a row: x y z, then the unit normal. */
export const ROW = 6;

export class PhyskinError extends Error {
  name = "PhyskinError";
}

let compiled = null;

export class NativeModule {
  /** With a memory of its own. wasm: as of `loadOutfit`. */
  static async load(wasm = new URL("physkin.wasm", import.meta.url)) {
    const instance = await WebAssembly.instantiate(await moduleOf(wasm), importsOf(() => instance.exports.memory));
    instance.exports._initialize();
    return new NativeModule(instance.exports);
  }

  /** @private */
  constructor(native) {
    this.native = native;
    const version = native.physkin_abi_version();
    if (version !== ABI_VERSION) {
      throw new PhyskinError(`physkin.wasm has interface version ${version}; this package takes ${ABI_VERSION}`);
    }
  }

  // Whatever is allocated may move the memory to another buffer: a view is made when it is used.
  view(Type, place, length) {
    return new Type(this.native.memory.buffer, place, length);
  }

  room(bytes) {
    const place = this.native.malloc(bytes || 1);
    if (place === 0) throw new PhyskinError(`there is no room in memory for ${bytes} bytes`);
    return place;
  }

  text(place) {
    const bytes = new Uint8Array(this.native.memory.buffer, place);
    return new TextDecoder().decode(bytes.subarray(0, bytes.indexOf(0)));
  }

  /** A copy in the module's memory, to be freed. */
  write(text) {
    const bytes = new TextEncoder().encode(`${text}\0`);
    const place = this.room(bytes.length);
    this.view(Uint8Array, place, bytes.length).set(bytes);
    return place;
  }

  check(status) {
    if (status !== 0) throw new PhyskinError(this.text(this.native.physkin_last_error()));
  }

  /** Rows of x y z and normal, from `place` on, into arrays in glTF's axes. */
  copyRows(place, positions, normals) {
    const rows = this.view(Float32Array, place, ROW * (positions.length / 3));
    for (let to = 0, at = 0; to < positions.length; to += 3, at += ROW) {
      positions[to] = rows[at + 1];
      positions[to + 1] = rows[at + 2];
      positions[to + 2] = rows[at];
      normals[to] = rows[at + 4];
      normals[to + 1] = rows[at + 5];
      normals[to + 2] = rows[at + 3];
    }
  }
}

export async function bytesOf(source) {
  if (source instanceof ArrayBuffer) return new Uint8Array(source);
  if (ArrayBuffer.isView(source)) return new Uint8Array(source.buffer, source.byteOffset, source.byteLength);
  const response = source instanceof Response ? source : await fetch(source);
  if (!response.ok) throw new PhyskinError(`cannot load ${response.url}: ${response.status} ${response.statusText}`);
  const bytes = new Uint8Array(await response.arrayBuffer());
  if (!/^\s*</.test(new TextDecoder().decode(bytes.subarray(0, 64)))) return bytes;
  const vite = 'with Vite, set optimizeDeps: { exclude: ["physkin"] }';
  throw new PhyskinError(`${response.url} is a page of HTML: the server has no such file, or hides it (${vite})`);
}

// Compiled once, however many outfits there are.
async function moduleOf(wasm) {
  if (wasm instanceof WebAssembly.Module) return wasm;
  const address = wasm instanceof URL || typeof wasm === "string" ? String(wasm) : null;
  if (address === null) return WebAssembly.compile(await bytesOf(wasm));
  if (compiled?.address !== address) {
    compiled = { address, module: bytesOf(wasm).then(WebAssembly.compile) };
    compiled.module.catch(() => (compiled = null)); // the next outfit tries again
  }
  return compiled.module;
}

// What the C library asks a system for; there are no environment variables, and nothing is printed.
function importsOf(memory) {
  const noEnvironment = (...places) => {
    const view = new DataView(memory().buffer);
    for (const place of places) view.setUint32(place, 0, true);
    return 0;
  };
  return {
    env: { emscripten_notify_memory_growth() {} },
    wasi_snapshot_preview1: {
      environ_get: () => 0,
      environ_sizes_get: noEnvironment,
      proc_exit(code) {
        throw new PhyskinError(`physkin.wasm has ended with code ${code}`);
      },
    },
  };
}
