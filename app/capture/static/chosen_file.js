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

const EXIF_HEADER = [0x45, 0x78, 0x69, 0x66, 0, 0]; // "Exif", before a TIFF structure, in JPEG and HEIC
const BYTE_ORDERS = [0x49, 0x4d]; // "II" or "MM": what a TIFF structure begins with; HEIC names its parts "Exif", too
const EXIF_IFD = 0x8769;
const DATE_TIME_ORIGINAL = 0x9003;
const OFFSET_TIME_ORIGINAL = 0x9011;

/** When the photograph was taken, by its EXIF; without an offset there, in this phone's time zone. null: it does not say. */
export function takenAt(bytes) {
  try {
    return exifTime(new DataView(bytes.buffer, bytes.byteOffset + exifStart(bytes)));
  } catch (error) {
    if (error instanceof RangeError) return null; // no EXIF, or one that is cut off
    throw error;
  }
}

function exifStart(bytes) {
  const isExif = (start) =>
    EXIF_HEADER.every((byte, place) => bytes[start + place] === byte) && BYTE_ORDERS.includes(bytes[start + EXIF_HEADER.length]);
  let start = bytes.indexOf(EXIF_HEADER[0]);
  while (start >= 0 && !isExif(start)) start = bytes.indexOf(EXIF_HEADER[0], start + 1);
  if (start < 0) throw new RangeError("There is no EXIF.");
  return start + EXIF_HEADER.length;
}

function exifTime(tiff) {
  const isLittleEndian = tiff.getUint16(0) === 0x4949;
  const first = entries(tiff, tiff.getUint32(4, isLittleEndian), isLittleEndian);
  const exif = entries(tiff, tiff.getUint32(first.get(EXIF_IFD), isLittleEndian), isLittleEndian);
  const text = (tag, length) => {
    const start = tiff.getUint32(exif.get(tag), isLittleEndian);
    return String.fromCharCode(...Array.from({ length }, (_, place) => tiff.getUint8(start + place)));
  };
  const [day, clock] = text(DATE_TIME_ORIGINAL, 19).split(" ");
  const offset = exif.has(OFFSET_TIME_ORIGINAL) ? text(OFFSET_TIME_ORIGINAL, 6) : "";
  const time = new Date(`${day.replaceAll(":", "-")}T${clock}${/^[+-]\d\d:\d\d$/.test(offset) ? offset : ""}`);
  return Number.isNaN(time.getTime()) ? null : time;
}

// Where the values of a directory, or their addresses, stand, by tag.
function entries(tiff, start, isLittleEndian) {
  const count = tiff.getUint16(start, isLittleEndian);
  const places = Array.from({ length: count }, (_, number) => start + 2 + 12 * number);
  return new Map(places.map((place) => [tiff.getUint16(place, isLittleEndian), place + 8]));
}
