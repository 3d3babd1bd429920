"""A camera for Chromium that shows photographs one after the other, over and over."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

FRAMES_A_SECOND = 1
FRAMES_OF_EACH = 12  # long enough to take the photograph on a busy machine


def write_video(path: Path, pictures: Sequence[np.ndarray], frames_of_each: int = FRAMES_OF_EACH) -> None:
    """Write (h, w, 3) BGR pictures as a Y4M video of I420 frames; all have the same even width and height."""
    height, width = pictures[0].shape[:2]
    with path.open("wb") as video:
        video.write(f"YUV4MPEG2 W{width} H{height} F{FRAMES_A_SECOND}:1 Ip A1:1 C420jpeg\n".encode())
        for picture in pictures:
            frame = b"FRAME\n" + cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420).tobytes()
            video.writelines([frame] * frames_of_each)


def camera_arguments(video: Path) -> list[str]:
    """Return Chromium's arguments that make the video its only camera, allowed to every page."""
    return [
        "--use-fake-device-for-media-stream",
        "--use-fake-ui-for-media-stream",
        f"--use-file-for-fake-video-capture={video}",
    ]
