"""FBX: what the USD stage holds, turned into FBX by Blender, the only free program that writes it.

Blender runs as a process of its own, without a window: its Python is not ours. Lengths are centimetres and y is up, as
Blender writes it for Unreal, Unity and MotionBuilder.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from pzcap.export import usd
from pzcap.export.take import Take
from pzcap.io.files import write_bytes
from pzcap.types import PzcapError

BLENDER: Final = "blender"
TIMEOUT_S: Final = 600
_SCRIPT: Final = """\
import sys
import bpy
source, target, fps, base, frames = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps, scene.render.fps_base = int(fps), float(base)
bpy.ops.wm.usd_import(filepath=source)
scene.render.fps, scene.render.fps_base = int(fps), float(base)
scene.frame_start, scene.frame_end = 0, int(frames) - 1
bpy.ops.export_scene.fbx(filepath=target, object_types={"ARMATURE", "MESH", "CAMERA", "EMPTY"}, add_leaf_bones=False,
                         bake_anim_use_all_actions=False, bake_anim_use_nla_strips=False, bake_anim_simplify_factor=0.0)
"""


def write(take: Take, folder: Path) -> list[Path]:
    """Write what of body and cameras there is; the file. PzcapError where there is no Blender, or it fails."""
    program = shutil.which(BLENDER)
    if program is None:
        raise PzcapError("FBX is written by Blender, and no program 'blender' is on the PATH; install it, or write bvh")
    whole = take.reconstruction
    fps = round(whole.frame_rate)
    with TemporaryDirectory() as own:
        [stage] = usd.write(take, Path(own))
        script, target = Path(own) / "convert.py", Path(own) / "take.fbx"
        script.write_text(_SCRIPT)
        line = [program, "--background", "--factory-startup", "--python-exit-code", "1", "--python", str(script), "--"]
        numbers = [str(fps), repr(float(fps / whole.frame_rate)), str(len(whole.timecodes))]
        try:
            done = subprocess.run(
                [*line, str(stage), str(target), *numbers], capture_output=True, text=True, timeout=TIMEOUT_S,
                check=False,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as error:
            raise PzcapError(f"{program}: does not run ({error}); start Blender once by hand") from error
        if done.returncode or not target.is_file():
            said = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()[-1]
            raise PzcapError(f"{program}: wrote no FBX, and said: {said}; Blender 4.2 or newer is needed")
        return [write_bytes(folder / f"{take.file}.fbx", target.read_bytes())]
