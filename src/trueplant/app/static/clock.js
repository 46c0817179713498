// Times of a record: its own numbers, the seconds that a plot has, and the clock of its zone.

/** How the times of a record are spoken of; `record` is what the app says of it. */
export function clockOf(record) {
  const stamped = record.start !== null;
  const toX = (t) => (stamped ? record.start + t * record.seconds : t);
  const toT = (x) => (stamped ? (x - record.start) / record.seconds : x);

  /** Seconds that the clock of the record's zone is ahead of UTC at a moment. */
  function offset(x) {
    let found = record.offsets[0]?.[1] ?? 0;
    for (const [from, seconds] of record.offsets) if (x >= from) found = seconds;
    return found;
  }

  /** The clock on the wall at a moment, such as 2024-03-31 04:15:00. */
  function clock(x, precise = false) {
    const date = new Date(Math.round((x + offset(x)) * 1000));
    if (Number.isNaN(date.getTime())) return "";
    const text = date.toISOString().replace("T", " ").slice(0, 23);
    return precise && !text.endsWith(".000") ? text : text.slice(0, 19);
  }

  /** A time as it is typed: with its offset where the zone is known, so that no hour is meant twice. */
  function written(t) {
    if (!stamped) return String(Number(t.toPrecision(9)));
    const x = toX(t);
    const text = clock(x, true);
    if (!record.offsets.length) return text;
    const minutes = Math.round(offset(x) / 60);
    const two = (n) => String(n).padStart(2, "0");
    return `${text}${minutes < 0 ? "-" : "+"}${two(Math.floor(Math.abs(minutes) / 60))}:${two(Math.abs(minutes) % 60)}`;
  }

  /** The nearest of the times at which samples are to be expected. */
  const near = (t) => Math.min(record.first + Math.round((t - record.first) / record.step) * record.step, record.last);

  return { stamped, toX, toT, offset, clock, written, near };
}

const DAY = 86400;
const below = (year, day) => [year, null, day, null, null, null, 1];

/** Of uPlot, by the distance of ticks in seconds: the label, and what stands below it where a year or a day begins. */
export const LABELS = [
  [365 * DAY, "{YYYY}", ...below(null, null)],
  [28 * DAY, "{YYYY}-{MM}", ...below(null, null)],
  [DAY, "{MM}-{DD}", ...below("\n{YYYY}", null)],
  [60, "{HH}:{mm}", ...below("\n{YYYY}-{MM}-{DD}", "\n{MM}-{DD}")],
  [1, "{HH}:{mm}:{ss}", ...below("\n{YYYY}-{MM}-{DD}", "\n{MM}-{DD}")],
  [0.001, "{HH}:{mm}:{ss}.{fff}", ...below("\n{YYYY}-{MM}-{DD}", "\n{MM}-{DD}")],
];
