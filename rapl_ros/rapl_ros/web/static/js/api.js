// Requests to the server: one form of error, and the token where one is needed.

import { settings } from "./settings.js";

export class ApiError extends Error {
  constructor(status, code, message) {
    super(message);
    this.status = status;
    this.code = code;
  }
}

// The token comes behind the # of the printed address, which browsers send nowhere.
const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) {
  settings.token = given;
  history.replaceState(null, "", location.pathname);
}

async function send(path, options) {
  const headers = { ...(options.headers ?? {}) };
  if (settings.token) headers.Authorization = `Bearer ${settings.token}`;
  let response;
  try {
    response = await fetch(path, { ...options, headers });
  } catch {
    throw new ApiError(0, "offline", "The server does not answer.");
  }
  if (response.ok) return response;
  let problem = {};
  try {
    problem = await response.json();
  } catch {
    // not one of ours, such as a proxy's
  }
  throw new ApiError(response.status, problem.code ?? "unknown", problem.message ?? response.statusText);
}

// The body may be cut short after its head came.
async function bodyOf(response, kind) {
  try {
    return await response[kind]();
  } catch {
    throw new ApiError(0, "cut_short", "The answer of the server was cut short.");
  }
}

export async function get(path) {
  return bodyOf(await send(path, {}), "json");
}

export async function post(path, body) {
  const options = {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
  };
  return bodyOf(await send(path, options), "json");
}

export async function getBlob(path, options = {}) {
  return bodyOf(await send(path, options), "blob");
}

// 128 random bits; crypto.randomUUID exists on secure origins only, not on http://10.0.0.5.
export function newId() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
