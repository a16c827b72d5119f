// Questions to the server: JSON both ways, pictures with the values that belong to them, errors as sentences.

export class ApiError extends Error {
  constructor(status, { code = "", message = "", problems = [] } = {}) {
    super(message || `The page's server answered ${status}.`);
    Object.assign(this, { status, code, problems });
  }
}

const BASE = "/api/v1/";
const where = (path) => (path.startsWith("/") ? path : BASE + path);

/** Ask, and return the response; `ApiError` for every answer that is none, and for no answer (status 0).
 *  @param {string} path @param {Omit<RequestInit, "body"> & {body?: object}} options */
async function asked(path, { method = "GET", body, ...options } = {}) {
  /** @type {RequestInit} */
  const sent = { method, credentials: "same-origin", cache: "no-store", ...options };
  if (method !== "GET")
    Object.assign(sent, { headers: { "Content-Type": "application/json" }, body: JSON.stringify(body ?? {}) });
  let response;
  try {
    response = await fetch(where(path), sent);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ApiError(0, {
      code: "offline",
      message: "The page's server does not answer. Is the device on, and this phone in its network?",
    });
  }
  if (response.status === 401) location.assign("/login");
  if (!response.ok) throw new ApiError(response.status, (await response.json().catch(() => ({}))).error);
  return response;
}

/** @param {string} path @param {Parameters<typeof asked>[1]} options @returns {Promise<any>} */
const json = async (path, options) => {
  const response = await asked(path, options);
  return response.status === 204 ? null : response.json();
};

/** @template {string} Method @template {string} P @typedef {import("answers").Answer<Method, P>} Answer */

/** Paths without a leading slash are below /api/v1/. `options` go to `fetch`: `signal`, `keepalive`. */
export const api = {
  /** @type {<P extends string>(path: P, options?: RequestInit) => Promise<Answer<"get", P>>} */
  get: (path, options) => json(path, options),
  /** @type {<P extends string>(path: P, body?: object, options?: RequestInit) => Promise<Answer<"post", P>>} */
  post: (path, body, options) => json(path, { method: "POST", body, ...options }),
  /** @type {<P extends string>(path: P, body: object, options?: RequestInit) => Promise<Answer<"put", P>>} */
  put: (path, body, options) => json(path, { method: "PUT", body, ...options }),
  /** @type {<P extends string>(path: P, options?: RequestInit) => Promise<Answer<"delete", P>>} */
  del: (path, options) => json(path, { method: "DELETE", ...options }),
  stream: (path, options) => asked(path, options),
  /** A picture or a drawing, and the values that came with it. */
  async picture(path, options) {
    const response = await asked(path, options);
    const values = response.headers.get("X-Values");
    return { blob: await response.blob(), values: values ? JSON.parse(decodeURIComponent(values)) : null };
  },
};
