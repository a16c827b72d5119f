// What the state of a rule looks like, and what it is called: the same on every view.

const LOOKS = { pending: "warning", clearing: "warning", returned: "warning", unknown: "unknown" };

/** Its shape and its colour; its word is always beside them. A rule that only drives an output is no alarm. */
export function lookOf({ status, severity, inhibits, acknowledged, is_alarm }) {
  if (status !== "active" && status !== "latched") return LOOKS[status] ?? "quiet";
  if (inhibits.length) return "warning";
  if (!is_alarm) return "good";
  if (severity === "alarm" || severity === "safety") return "alarm";
  if (!acknowledged || status === "latched") return severity === "info" ? "warning" : "alarm";
  return severity === "info" ? "good" : "warning";
}

export function stateInWords(rule) {
  const extra = [
    ...rule.inhibits,
    rule.acknowledged ? "" : "not acknowledged",
    rule.chattering ? "chattering" : "",
    rule.first_out ? "first" : "",
  ];
  return [rule.status, ...extra].filter(Boolean).join(", ");
}
