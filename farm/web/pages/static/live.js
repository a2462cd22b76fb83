// Updates a live page with the changed elements that the farm sends as server-sent events.
// An update keeps the focus, open forms and typed text. The event "element-received" gives each new element to other scripts.

const RETRY_MS = 3000;
const MAX_SILENCE_MS = 15000; // time without an event after which the page warns that it may be outdated
const STILL_INTERVAL_MS = 5000; // time between two stills of a camera

const main = document.getElementById("main");
const page = document.body.dataset.live;
let version = document.body.dataset.version;
let source = null;
let contactMs = Date.now();
let retryTimer = 0;

const canReuse = (old, fresh) => old.nodeType === fresh.nodeType && old.nodeName === fresh.nodeName && !old.id && !fresh.id;

const removeAndGetNext = (node) => {
  const next = node.nextSibling;
  node.remove();
  return next;
};

const syncAttributes = (old, fresh) => {
  for (const { name, value } of fresh.attributes) {
    if (name === "src" && old.hasAttribute("data-still")) continue;
    if (old.getAttribute(name) !== value) old.setAttribute(name, value);
  }
  for (const { name } of [...old.attributes]) {
    if (!fresh.hasAttribute(name) && !(name === "open" && old.nodeName === "DETAILS")) old.removeAttribute(name);
  }
};

/** Make an element equal to a new one, but reuse its nodes; child elements with ids are matched by id. */
export const sync = (old, fresh) => {
  if (old.nodeType !== Node.ELEMENT_NODE) {
    if (old.data !== fresh.data) old.data = fresh.data;
    return;
  }
  syncAttributes(old, fresh);
  const known = new Map([...old.children].filter((child) => child.id).map((child) => [child.id, child]));
  const wanted = new Set([...fresh.children].map((child) => child.id));
  let next = old.firstChild;
  for (const child of [...fresh.childNodes]) {
    while (next && next.id && !wanted.has(next.id)) next = removeAndGetNext(next);
    const same = child.id ? known.get(child.id) : next && canReuse(next, child) && next;
    if (!same) {
      old.insertBefore(child, next);
      continue;
    }
    if (same === next) next = next.nextSibling;
    else old.insertBefore(same, next);
    sync(same, child);
  }
  while (next) next = removeAndGetNext(next);
};

const applyChanges = (changes) => {
  const focused = document.activeElement;
  for (const [id, html] of Object.entries(changes)) {
    const template = document.createElement("template");
    template.innerHTML = html;
    const fresh = template.content.firstElementChild;
    document.dispatchEvent(new CustomEvent("element-received", { detail: fresh }));
    const old = document.getElementById(id);
    if (old) sync(old, fresh);
  }
  if (focused !== document.activeElement && focused.isConnected) focused.focus({ preventScroll: true });
};

// -- warning of outdated content ------------------------------------------------------------------------------

const warning = document.createElement("p");
warning.className = "stale";
warning.hidden = true;
document.getElementById("notes").append(warning);

const showWarning = (isStale) => {
  if (isStale && warning.hidden) {
    const since = new Date(contactMs).toLocaleTimeString([], { hour12: false });
    warning.textContent = `No updates from the farm since ${since}. This page may be outdated; trying again.`;
  }
  warning.hidden = !isStale;
};

// -- the stream -------------------------------------------------------------------------------------------------

const recordContact = () => {
  contactMs = Date.now();
  showWarning(false);
};

const disconnect = () => {
  clearTimeout(retryTimer);
  source?.close();
  source = null;
};

const connect = () => {
  disconnect();
  if (document.hidden) return;
  source = new EventSource(`/live?${new URLSearchParams({ page, version })}`);
  source.onmessage = (event) => {
    recordContact();
    version = event.lastEventId;
    applyChanges(JSON.parse(event.data));
  };
  source.addEventListener("beat", recordContact);
  source.onerror = () => {
    disconnect();
    showWarning(true);
    retryTimer = setTimeout(connect, RETRY_MS);
  };
};

const showStills = () => {
  if (document.hidden) return;
  for (const image of main.querySelectorAll("img[data-still]")) {
    const { bottom, top } = image.getBoundingClientRect();
    if (bottom > 0 && top < innerHeight) image.src = `${image.src.split("?")[0]}?at=${Date.now()}`;
  }
};

if (page) {
  document.addEventListener("visibilitychange", connect); // a hidden tab has no stream
  addEventListener("pagehide", disconnect);
  addEventListener("pageshow", (event) => event.persisted && connect());
  addEventListener("online", connect);
  addEventListener("offline", () => source?.onerror()); // an open stream may report no error
  setInterval(() => source && Date.now() - contactMs > MAX_SILENCE_MS && source.onerror(), 1000);
  setInterval(showStills, STILL_INTERVAL_MS);
  connect();
}
