// Times of a page in the reader's time zone. Without this script they are in the fleet's.

const offsetOf = /([+-])(\d\d):(\d\d)$|Z$/;

/** Return the fleet's offset from UTC in minutes, as an ISO 8601 time names it. */
const readOffset = (iso) => {
  const found = offsetOf.exec(iso);
  return !found || !found[1] ? 0 : (found[1] === "-" ? -1 : 1) * (60 * Number(found[2]) + Number(found[3]));
};

/** Show the times inside an element in the reader's zone, where that differs. */
const localiseTimes = (root) => {
  for (const element of root.querySelectorAll("time[datetime]")) {
    if (element.closest("[data-farm-time]")) continue; // beside a chart in the fleet's zone
    const iso = element.getAttribute("datetime");
    const moment = new Date(iso);
    if (Number.isNaN(moment.getTime()) || -moment.getTimezoneOffset() === readOffset(iso)) continue;
    const isFar = Math.abs(moment - Date.now()) > 6 * 24 * 3600 * 1000;
    const day = isFar ? { day: "numeric", month: "short" } : { weekday: "short" };
    document.getElementById("zones").hidden = false;
    element.title = `${element.textContent} in the farm's time zone`;
    element.textContent = moment.toLocaleString([], { ...day, hour: "2-digit", minute: "2-digit", hour12: false });
  }
};

localiseTimes(document);
document.addEventListener("fresh", (event) => localiseTimes(event.detail));
