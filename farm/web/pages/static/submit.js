// Shows the progress of an upload, and of the inspection of the model, while the browser sends the form.

const POLL_INTERVAL_MS = 500;

/** Describe the progress of an upload in a few words. */
export const describeUpload = ({ step, received, size }) =>
  received < size ? `${step}, ${Math.floor((100 * received) / size)} %` : step;

const form = document.getElementById("submit");
const progress = document.getElementById("progress");

const poll = async () => {
  try {
    const answer = await fetch(`/api/v1/uploads/${form.dataset.request}`);
    if (answer.ok) progress.textContent = describeUpload(await answer.json());
  } catch {
    // the page is closing, or the network is down, which the browser reports
  }
  setTimeout(poll, POLL_INTERVAL_MS);
};

// Input in a field selects the radio button of its choice, such as the number of printers.
form.addEventListener("input", ({ target }) => {
  const choice = target.closest(".choice")?.querySelector("[type=radio]");
  if (choice && target !== choice) choice.checked = true;
});

form.addEventListener("submit", () => {
  progress.textContent = "sending";
  setTimeout(poll, POLL_INTERVAL_MS);
});
