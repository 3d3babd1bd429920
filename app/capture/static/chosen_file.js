// A file that the person chose, read by its bytes: a browser names types by the file's name, and decodes not all of them.

const HEIF_BRANDS = new Set(["heic", "heix", "heim", "heis", "hevc", "hevx", "mif1", "msf1"]); // as the server's

/** True for the kinds of photographs that the server takes: JPEG, PNG, WebP, HEIC. */
export function isPhotograph(bytes) {
  const start = String.fromCharCode(...bytes.subarray(0, 12));
  const brand = start.slice(8);
  return (
    start.startsWith("\xff\xd8\xff") ||
    start.startsWith("\x89PNG\r\n\x1a\n") ||
    (start.startsWith("RIFF") && brand === "WEBP") ||
    (start.slice(4, 8) === "ftyp" && HEIF_BRANDS.has(brand))
  );
}
