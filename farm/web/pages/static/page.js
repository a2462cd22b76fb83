// Times of a page in the reader's time zone. Without this script they are in the farm's.

const offsetOf = /([+-])(\d\d):(\d\d)$|Z$/;

/** Return the farm's offset from UTC in minutes, as an ISO 8601 time names it. */
const readOffset = (iso) => {
  const found = offsetOf.exec(iso);
  return !found || !found[1] ? 0 : (found[1] === "-" ? -1 : 1) * (60 * Number(found[2]) + Number(found[3]));
};

/** Return a time in the reader's words; null where these are the farm's. Marks of a chart may have no day. */
const formatMoment = (iso, text) => {
  const moment = new Date(iso);
  if (Number.isNaN(moment.getTime()) || -moment.getTimezoneOffset() === readOffset(iso)) return null;
  const days = Math.abs(moment - Date.now()) / (24 * 3600 * 1000);
  const far = { day: "numeric", month: "short", ...(days > 300 ? { year: "numeric" } : {}) };
  const date = /^\d\d:\d\d$/.test(text) ? {} : days > 6 ? far : { weekday: "short" };
  return moment.toLocaleString([], { ...date, hour: "2-digit", minute: "2-digit", hour12: false });
};

/** Show the times inside an element in the reader's zone, where that differs, and say so below the page. */
const localiseTimes = (root) => {
  let isLocal = false;
  for (const element of root.querySelectorAll("time[datetime], [data-time]")) {
    if (element.closest("[data-farm-time]")) continue; // a page in the farm's zone
    const text = element.dataset.text ?? element.textContent; // the first is a part of the second
    const words = formatMoment(element.dataset.time ?? element.getAttribute("datetime"), text);
    if (words === null) continue;
    isLocal = true;
    if (element.localName === "time") element.title = `${text} in the farm's time zone`;
    element.textContent = element.textContent.replace(text, () => words);
  }
  const note = document.getElementById("zones");
  if (!isLocal || !note) return;
  const { timeZone } = Intl.DateTimeFormat().resolvedOptions();
  note.textContent = `Times are in your time zone, ${timeZone}. The farm is in ${note.dataset.zone}.`;
};

localiseTimes(document);
document.addEventListener("fresh", (event) => localiseTimes(event.detail));
