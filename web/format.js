// Numbers, intervals and the honesty labels that stand beside every joule.

const figures = new Intl.NumberFormat("en", { maximumSignificantDigits: 3 });
const THIN = "\u202f";

export const QUALITY = {
  measured: { label: "measured joules", unit: "J", explanation: "Joules were measured on this device." },
  estimated: {
    label: "estimated joules", unit: "J estimated",
    explanation: "Joules come from a model of this device, not from a meter.",
  },
  replayed: {
    label: "replayed joules", unit: "J replayed",
    explanation: "Joules come from a discharge trace that was played back, not from this device: "
      + "good for trying joulebox out, not for conclusions.",
  },
  time_only: {
    label: "time only", unit: "J",
    explanation: "This device has no energy source that joulebox can read, so seconds stand in for joules.",
  },
};

export const quality = (name) => QUALITY[name] ?? QUALITY.time_only;

export function number(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "unknown";
  if (value !== 0 && (Math.abs(value) < 1e-3 || Math.abs(value) >= 1e6)) return value.toExponential(1);
  return figures.format(value);
}

export const percent = (share) => (Number.isFinite(share) ? `${number(share * 100)}${THIN}%` : "unknown");

export function interval(estimate, unit = "") {
  if (!estimate) return "not measured";
  const { value, low, high } = estimate;
  const suffix = unit ? ` ${unit}` : "";
  const known = Number.isFinite(low) && Number.isFinite(high) && high > low;
  return `${number(value)}${suffix}${known ? ` (${number(low)} to ${number(high)})` : ""}`;
}

export const settingsText = (changed) =>
  Object.entries(changed ?? {}).map(([name, value]) => `${name} = ${value}`).join(", ") || "base settings";

export function ago(moment, now = Date.now()) {
  const seconds = Math.max(0, (now - Date.parse(moment)) / 1000);
  if (!Number.isFinite(seconds)) return "never";
  if (seconds < 60) return "just now";
  for (const [unit, size] of [["min", 60], ["h", 3600], ["day", 86400]].reverse()) {
    const count = Math.floor(seconds / size);
    if (count >= 1) return `${count} ${unit}${unit === "day" && count > 1 ? "s" : ""} ago`;
  }
  return "just now";
}

// Seconds as a person would say them: 45 s, 12 min, 3.5 h, 2 days.
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return "unknown";
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return seconds < 172_800 ? `${number(seconds / 3600)} h` : `${number(seconds / 86_400)} days`;
}

export const clock = (moment) => new Intl.DateTimeFormat("en-GB", {
  hour: "2-digit", minute: "2-digit", ...(Math.abs(moment - Date.now()) > 43_200_000 ? { day: "numeric", month: "short" } : {}),
}).format(moment);
