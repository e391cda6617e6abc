"""Reads examples from files, each with a loader that must refuse or accept it, and writes what came of each.

    python fuzz_worker.py {scene|exr|picture} EXAMPLES.jsonl OUTCOMES.jsonl

Runs in a process of its own, so that an abort, a crash or a hang is seen from outside: the outcomes then end early.
"""

from __future__ import annotations

import base64
import json
import sys
import tempfile
import time
from pathlib import Path


def main(kind: str, examples: str, outcomes: str) -> None:
    judge = {"scene": judge_scene, "exr": judge_exr, "picture": judge_picture}[kind]
    with (
        tempfile.TemporaryDirectory() as folder,
        open(examples, encoding="utf-8") as given,
        open(outcomes, "w", encoding="utf-8") as out,
    ):
        judge(b"", Path(folder))  # untimed: the first one waits for the imports
        for line in given:
            start = time.process_time()
            outcome, message = judge(base64.b64decode(json.loads(line)), Path(folder))
            out.write(json.dumps([outcome, message, time.process_time() - start]) + "\n")
            out.flush()


def judge_scene(content: bytes, folder: Path) -> tuple[str, str]:
    from speckle_mi.scene.read import assembly_from_scene
    from speckle_mi.scene.errors import one_line
    from speckle_mi.scene.load import open_scene

    path = folder / "scene.xml"
    path.write_bytes(content)
    try:
        assembly_from_scene(open_scene(str(path), [], "llvm_ad_mono"))
    except (ValueError, OSError, RuntimeError, MemoryError) as error:  # what the commands turn into one line
        return "refused", one_line(error)
    except Exception as error:
        return "fell over", repr(error)
    return "accepted", ""


def judge_exr(content: bytes, folder: Path) -> tuple[str, str]:
    from speckle_mi.images.exr import read_field

    return _judge_image(content, folder / "image.exr", read_field)


def judge_picture(content: bytes, folder: Path) -> tuple[str, str]:
    from speckle_mi.images.pictures import read_image
    from speckle_mi.machine.quiet import muted

    with muted():
        return _judge_image(content, folder / "image", read_image)  # what it is says the content, not the name


def _judge_image(content: bytes, path: Path, read) -> tuple[str, str]:
    from speckle_mi.images.field_image import FieldImageError

    path.write_bytes(content)
    try:
        image = read(path)
    except FieldImageError as error:
        return "refused", str(error)
    except Exception as error:
        return "fell over", repr(error)
    return ("accepted", "") if image.intensity.ndim == 2 else ("fell over", f"shape {image.intensity.shape}")


if __name__ == "__main__":
    main(*sys.argv[1:])
