/** The errors of a call: a Problem if the server refused it, a NetworkError if no whole answer came. */

/** The server's refusal, an RFC 9457 problem document. `code` is stable: docs/errors.md lists all codes. */
export class Problem extends Error {
  /**
   * @param {number} status The HTTP status.
   * @param {Record<string, unknown> | null} document null: the answer is no problem document, so a proxy made it, not the server.
   * @param {number | null} retryAfterSeconds From `Retry-After`; null: the answer has none.
   */
  constructor(status, document, retryAfterSeconds) {
    const detail = typeof document?.detail === "string" ? document.detail : `The server answered ${status}.`;
    super(detail);
    this.name = "Problem";
    this.status = status;
    /** The cause, for programs. `unknown` if a proxy answered. */
    this.code = typeof document?.code === "string" ? document.code : "unknown";
    /** A sentence for a person. */
    this.detail = detail;
    /** True if the same request may succeed later. */
    this.retryable = typeof document?.retryable === "boolean" ? document.retryable : TRANSIENT.has(status);
    this.retryAfterSeconds = retryAfterSeconds;
    /** The whole document: further members name the limit, the slot or the field. */
    this.document = document ?? {};
  }
}

/** No whole answer came: the connection failed or broke off, or the call's time was up. What was sent may have arrived. */
export class NetworkError extends Error {
  /**
   * @param {string} message
   * @param {unknown} cause What `fetch` threw.
   */
  constructor(message, cause) {
    super(message, { cause });
    this.name = "NetworkError";
  }
}

export const TRANSIENT = new Set([408, 425, 429, 500, 502, 503, 504]);
