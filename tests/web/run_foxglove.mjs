// What the converter for Foxglove makes of messages: node run_foxglove.mjs BUNDLE CASE, scene updates as JSON.
//   CASE: [[schema, topic, message], ...] as they come
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [bundle, path] = process.argv.slice(2);
const { activate } = await import(pathToFileURL(bundle).href);
const converters = new Map();
activate({ registerMessageConverter: ({ fromSchemaName, ...rest }) => converters.set(fromSchemaName, rest) });
const typed = (value) => (Array.isArray(value) && typeof value[0] === "number" ? Float64Array.from(value) : value);
const answers = JSON.parse(readFileSync(path)).map(([schema, topic, message]) => {
  const given = Object.fromEntries(Object.entries(message).map(([name, value]) => [name, typed(value)]));
  const { toSchemaName, converter } = converters.get(schema);
  const before = performance.now();
  const scene = converter(given, { topic });
  const milliseconds = performance.now() - before;
  for (const { triangles } of scene.entities) triangles[0].indices = Array.from(triangles[0].indices);
  return { toSchemaName, scene, milliseconds };
});
process.stdout.write(JSON.stringify(answers));
