"""A writer of another package: one JSON object per frame."""

import json

NAME = "jsonl"


class JsonLinesWriter:
    files = ("frames.jsonl",)

    def open(self, info, folder):
        self.file = (folder / "frames.jsonl").open("w", encoding="utf-8")
        self.camera = {"focal_px": info.camera.fx_px, "fps": info.fps}

    def write(self, result):
        ids = result.tracks.track_id.tolist()
        self.file.write(
            json.dumps({"frame": result.index, "time_s": result.time_s, "ids": ids}) + "\n"
        )

    def close(self, summary):
        self.file.write(
            json.dumps({**self.camera, "frames": None if summary is None else summary["frames"]})
            + "\n"
        )
        self.file.close()
