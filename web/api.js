// The one door to the server: JSON, pictures and live events, with the token where one is needed.

const TOKEN = "joulebox-token";

export class ApiError extends Error {
  constructor(message, status, code) {
    super(message);
    this.status = status;
    this.code = code;
  }
}

export const token = () => sessionStorage.getItem(TOKEN);
export const keepToken = (value) => (value ? sessionStorage.setItem(TOKEN, value) : sessionStorage.removeItem(TOKEN));

export function query(parameters) {
  const given = Object.entries(parameters).filter(([, value]) => value !== null && value !== undefined && value !== "");
  return given.length ? `?${new URLSearchParams(given)}` : "";
}

// Asks for a token when the server wants one, and goes on with it. The page sets this; it answers a promise of true
// when there is a new token to try.
let askForToken = async () => false;
export const onTokenWanted = (listener) => { askForToken = listener; };

async function ask(path, { headers = {}, ...options } = {}) {
  const authorization = token() ? { Authorization: `Bearer ${token()}` } : {};
  let response;
  try {
    response = await fetch(path, { ...options, headers: { ...headers, ...authorization } });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ApiError("The server does not answer. Is joulebox serve still running?", 0, "unreachable");
  }
  if (response.ok) return response;
  const body = await response.json().catch(() => ({}));
  const detail = body.detail || body.title || `The server answered ${response.status}.`;
  const words = typeof detail === "string" ? detail : JSON.stringify(detail);
  const changes = (options.method ?? "GET") !== "GET";
  if (response.status === 401 || (response.status === 403 && changes)) {
    const again = await askForToken({ role: changes ? "operator" : "viewer", refused: token() ? words : null });
    if (again) return ask(path, { headers, ...options });
  }
  throw new ApiError(words, response.status, body.code);
}

export const getJson = async (path, options) => (await ask(path, options)).json();
export const getText = async (path, options) => (await ask(path, options)).text();
export const getBytes = async (path) => (await ask(path)).arrayBuffer();

// What changes something: JSON, or the text of a pasted file.
export async function send(method, path, content, headers = {}) {
  const text = typeof content === "string";
  const type = content === undefined ? {} : { "Content-Type": text ? "text/plain" : "application/json" };
  const answer = await ask(path, { method, body: text ? content : JSON.stringify(content), headers: { ...type, ...headers } });
  return answer.status === 204 ? null : answer.json();
}

// Every page of a list, up to `most` items: lists are always limited on the server's side.
export async function getItems(path, parameters = {}, most = 1000) {
  const items = [];
  let cursor = null;
  do {
    const page = await getJson(path + query({ ...parameters, limit: 200, cursor }));
    items.push(...(page.items ?? []));
    cursor = page.next;
  } while (cursor && items.length < most);
  return items;
}

// Pictures are fetched and not linked, because <img src> cannot carry a token, and to have the server's words on error.
export const getPicture = async (path, options) => URL.createObjectURL(await (await ask(path, options)).blob());

export async function save(path, name) {
  const url = await getPicture(path);
  Object.assign(document.createElement("a"), { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

// Server-sent events through fetch, since EventSource cannot carry a token either. Calls onEvent(name, data) and
// onState("live" | "lost" | "polling"); comes back by itself with the last id it saw, and calls onPoll every
// few seconds for as long as the stream is down.
export function listen({ onEvent, onState, onPoll, pollEvery = 5000 }) {
  let lastId = null;
  let wait = 1000;
  let failures = 0;
  let poller = null;

  const stopPolling = () => { clearInterval(poller); poller = null; };
  const startPolling = () => { poller ??= setInterval(() => onPoll().then(() => onState("polling"), () => onState("lost")), pollEvery); };

  async function connect() {
    const headers = { Accept: "text/event-stream", ...(lastId ? { "Last-Event-ID": lastId } : {}) };
    try {
      const response = await ask("/v1/events", { headers, cache: "no-store" });
      const missed = failures > 0;
      failures = 0;
      wait = 1000;
      stopPolling();
      onState("live");
      if (missed) onPoll().catch(() => {});
      await readEvents(response.body, (event) => {
        if (event.id) lastId = event.id;
        if (event.data) onEvent(event.name, event.data);
      });
    } catch (error) {
      if (error.status === 401) return; // nobody signed in; signing in starts a new stream
    }
    failures += 1;
    if (failures > 1) { onState("lost"); startPolling(); }
    setTimeout(connect, wait * (0.75 + Math.random() / 2));
    wait = Math.min(wait * 2, 30_000);
  }
  connect();
}

// Parses a text/event-stream body (WHATWG HTML, 9.2.6) until it ends.
export async function readEvents(body, deliver) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const blocks = (rest + value).replaceAll("\r\n", "\n").split("\n\n");
    rest = blocks.pop();
    for (const block of blocks) deliver(parseEvent(block));
  }
}

function parseEvent(block) {
  const event = { name: "message", id: null, data: null };
  const lines = [];
  for (const line of block.split("\n")) {
    const [, field, value] = /^([^:]*):? ?(.*)$/.exec(line);
    if (field === "event") event.name = value;
    else if (field === "id") event.id = value;
    else if (field === "data") lines.push(value);
  }
  if (lines.length) {
    try { event.data = JSON.parse(lines.join("\n")); } catch { event.data = { text: lines.join("\n") }; }
  }
  return event;
}
