// The phone's camera: a preview whose frames are analysed, and full-resolution stills with their EXIF.
//
// ImageCapture.takePhoto gives the camera's own JPEG. Where it is lacking (Safari), a frame of the preview would be small
// and without a focal length, so there the system's camera takes the photograph, by a file input.

/** True if this browser can take stills from a preview. */
export const canTakeStills = () => "ImageCapture" in globalThis && Boolean(navigator.mediaDevices?.getUserMedia);

/**
 * Open the back camera and show it in a <video>. Rejects with a DOMException if there is none or it is not allowed.
 * Returns {track, takePhoto(): Promise<Blob>, close()}.
 */
export async function openCamera(video) {
  const stream = await navigator.mediaDevices.getUserMedia({
    audio: false,
    video: { facingMode: { ideal: "environment" }, width: { ideal: 4096 }, height: { ideal: 3072 } },
  });
  const [track] = stream.getVideoTracks();
  const close = () => {
    stream.getTracks().forEach((track) => track.stop());
    video.srcObject = null;
  };
  video.srcObject = stream;
  try {
    await video.play();
  } catch (error) {
    close(); // the page was left
    throw error;
  }
  const capture = canTakeStills() ? new ImageCapture(track) : null;
  return {
    track,
    takePhoto: capture ? () => takeLargest(capture) : null,
    close,
  };
}

/**
 * Let the person choose or take a photograph with the system's camera; null if they cancel. Older browsers (Safari before
 * 16.4) do not tell of cancelling: the promise then stays open.
 */
export function pickPhotograph({ fromCamera }) {
  const input = document.createElement("input");
  Object.assign(input, { type: "file", accept: "image/*", hidden: true });
  if (fromCamera) input.setAttribute("capture", "environment");
  document.body.append(input); // iOS forgets inputs that are in no document
  return new Promise((resolve) => {
    const end = (file) => {
      input.remove();
      resolve(file);
    };
    input.addEventListener("change", () => end(input.files[0] ?? null));
    input.addEventListener("cancel", () => end(null));
    input.click();
  });
}

/** A small JPEG of a photograph, upright, for lists; null if this browser cannot decode it (HEIC). */
export async function thumbnail(blob, width_px = 320) {
  try {
    const bitmap = await createImageBitmap(blob, { resizeWidth: width_px, resizeQuality: "medium" });
    const canvas = Object.assign(document.createElement("canvas"), { width: bitmap.width, height: bitmap.height });
    canvas.getContext("2d").drawImage(bitmap, 0, 0);
    return await new Promise((resolve) => canvas.toBlob(resolve, "image/jpeg", 0.7));
  } catch {
    return null;
  }
}

/**
 * One frame of the preview, or a part of it, at most `side_px` on its long side, as ImageData; null while there is none.
 * part: size, a share of the frame's width and height; x, y: 0 at the left and the top edge, 1 at the others.
 */
export function grabFrame(video, canvas, side_px, part = { size: 1, x: 0, y: 0 }) {
  if (!video.videoWidth) return null;
  const [width, height] = [video.videoWidth * part.size, video.videoHeight * part.size];
  const [left, top] = [(video.videoWidth - width) * part.x, (video.videoHeight - height) * part.y];
  const scale = Math.min(1, side_px / Math.max(width, height));
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(video, left, top, width, height, 0, 0, canvas.width, canvas.height);
  return context.getImageData(0, 0, canvas.width, canvas.height);
}

async function takeLargest(capture) {
  const { imageWidth, imageHeight } = await capture.getPhotoCapabilities();
  const settings = imageWidth?.max ? { imageWidth: imageWidth.max, imageHeight: imageHeight.max } : {};
  try {
    return await capture.takePhoto(settings);
  } catch {
    return capture.takePhoto(); // some cameras announce sizes that they do not take
  }
}
