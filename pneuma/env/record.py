"""Gymnasium's RecordVideo without moviepy, which cannot be installed beside Pneuma's Pillow."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from gymnasium import wrappers
from gymnasium.error import DependencyNotInstalled

from pneuma.env.watch import write_video


class RecordVideo(wrappers.RecordVideo[Any, Any]):
    """Gymnasium's wrapper with its arguments; videos are written by imageio-ffmpeg (extra `video`).

    Raises:
        UserError: at the end of a recording, for a missing imageio-ffmpeg or a video that cannot be written.
    """

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        with suppress(DependencyNotInstalled):  # that there is no moviepy, after all else is set up
            super().__init__(*arguments, **keywords)

    def stop_recording(self) -> None:
        """Write the recording, if it has frames."""
        frames: Any = self.recorded_frames
        self.recorded_frames, self.recording = [], False
        if frames:
            path = Path(self.video_folder, f"{self._video_name}.mp4")
            write_video(path, frames, self.frames_per_sec)
