// Converts the times of a page from the farm's time zone to the reader's.

const OFFSET_PATTERN = /([+-])(\d\d):(\d\d)$|Z$/;

/** Return the offset from UTC, in minutes, of an ISO 8601 time. */
const readOffset = (iso) => {
  const found = OFFSET_PATTERN.exec(iso);
  return !found || !found[1] ? 0 : (found[1] === "-" ? -1 : 1) * (60 * Number(found[2]) + Number(found[3]));
};

/** Format a time in the reader's time zone, without a date if `text` has none; null if both zones have the same UTC offset. */
const formatMoment = (iso, text) => {
  const moment = new Date(iso);
  if (Number.isNaN(moment.getTime()) || -moment.getTimezoneOffset() === readOffset(iso)) return null;
  const days = Math.abs(moment - Date.now()) / (24 * 3600 * 1000);
  const far = { day: "numeric", month: "short", ...(days > 300 ? { year: "numeric" } : {}) };
  const date = /^\d\d:\d\d$/.test(text) ? {} : days > 6 ? far : { weekday: "short" };
  return moment.toLocaleString([], { ...date, hour: "2-digit", minute: "2-digit", hour12: false });
};

/** Convert the times inside an element to the reader's time zone if it differs, and then say so in the footer. */
const localiseTimes = (root) => {
  let isLocal = false;
  for (const element of root.querySelectorAll("time[datetime], [data-time]")) {
    if (element.closest("[data-farm-time]")) continue; // this part of the page uses the farm's time zone
    const text = element.dataset.text ?? element.textContent; // with `data-text`, the content has more than the time
    const localText = formatMoment(element.dataset.time ?? element.getAttribute("datetime"), text);
    if (localText === null) continue;
    isLocal = true;
    if (element.localName === "time") element.title = `${text} in the farm's time zone`;
    element.textContent = element.textContent.replace(text, () => localText);
  }
  const note = document.getElementById("zones");
  if (!isLocal || !note) return;
  const { timeZone } = Intl.DateTimeFormat().resolvedOptions();
  note.textContent = `Times are in your time zone, ${timeZone}. The farm is in ${note.dataset.zone}.`;
};

localiseTimes(document);
document.addEventListener("element-received", (event) => localiseTimes(event.detail));
