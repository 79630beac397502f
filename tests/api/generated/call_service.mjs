// @ts-check
// Calls a service with a client that is typed by what openapi-typescript made of its description; tsc checks the types.
//
//     node call_service.mjs http://127.0.0.1:8000 MODEL IMAGE
import { readFile } from "node:fs/promises";
import createClient from "openapi-fetch";

const [url, model, image] = process.argv.slice(2);
/** @type {ReturnType<typeof createClient<import("./schema.d.ts").paths>>} */
const client = createClient({ baseUrl: url });

/**
 * @template T
 * @param {{data?: T, error?: unknown}} answer
 * @returns {NonNullable<T>}
 */
function told(answer) {
  if (answer.data === undefined || answer.data === null) throw new Error(JSON.stringify(answer.error));
  return answer.data;
}

const form = new FormData();
form.append("file", new Blob([new Uint8Array(await readFile(model))]), "cube.glb");
const uploaded = told(await client.POST("/v1/models", { body: { file: "" }, bodySerializer: () => form }));
const session = told(await client.POST("/v1/sessions", { body: { model_id: uploaded.model_id } }));

// The types say "string" for bytes (https://openapi-ts.dev/openapi-fetch/api#bodyserializer); these go as they are.
const picture = await readFile(image);
const bytes = {
  body: "",
  bodySerializer: () => picture,
  headers: { "Content-Type": "application/octet-stream" },
};
const path = { session_id: session.session_id };
told(await client.POST("/v1/sessions/{session_id}/background", { params: { path }, ...bytes }));
const frame = told(
  await client.PUT("/v1/sessions/{session_id}/frames/{index}", {
    params: { path: { ...path, index: 0 }, query: { time: "2026-11-20T03:04:05Z" } },
    ...bytes,
  }),
);
const page = told(await client.GET("/v1/sessions/{session_id}/estimates", { params: { path } }));
const w = page.estimates.map((estimate) => estimate.best.orientation.w);
if (!("best" in frame)) throw new Error("the frame was taken, not tracked");
console.log(JSON.stringify({ time: frame.time, frames: page.estimates.length, w }));
