"""Files that nobody finds half-written."""

from __future__ import annotations

import json
import threading
from pathlib import Path

from tissue_sim.whole_files import write_json


def test_whoever_reads_finds_all_of_one_version(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    write_json(path, [0] * 20_000)
    done = threading.Event()

    def write() -> None:
        for version in range(1, 21):
            write_json(path, [version] * 20_000)
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    while not done.is_set():
        content = json.loads(path.read_text(encoding="utf-8"))
        assert len(content) == 20_000
        assert len(set(content)) == 1
    writer.join()
    assert [file.name for file in tmp_path.iterdir()] == ["report.json"]
