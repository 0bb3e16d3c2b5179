"""The figures on disk: PNG and SVG of each, one page, and a recording for the viewer."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import rerun as rr
import rerun.blueprint as rrb

from experiments import pages
from experiments.paper_figures.canvas import Drawn
from experiments.paper_figures.material import Run
from pzcap.io.files import written_whole
from pzcap.viewer import columns
from pzcap.viewer.columns import plain, view_path
from pzcap.viewer.utf8_name import with_utf8_name

APPLICATION: Final = "pzcap-figures-v1"
PAGE: Final = "index.html"
RECORDING: Final = "figures.rrd"


def save(drawn: Drawn, folder: Path) -> None:
    """PNG and SVG, the same bytes every time."""
    drawn.figure.savefig(folder / f"{drawn.stem}.png", metadata={"Software": None})
    drawn.figure.savefig(folder / f"{drawn.stem}.svg", metadata={"Date": None, "Creator": None})


def write_page(folder: Path, figures: Sequence[Drawn], runs: Sequence[Run], command: str) -> None:
    """The page, which shows the PNGs that lie beside it."""
    names = [run.reconstruction.capture_name for run in runs]
    pages.write(folder / PAGE, "figures.html.j2", {"figures": figures, "runs": names, "command": command})


def write_recording(folder: Path, figures: Sequence[Drawn], walk: Run) -> None:
    """Each figure and its caption as a tab, and the pedestrian in the hall with time running (Figs. 11 and 12)."""
    with written_whole(folder / RECORDING) as partial:
        rec = rr.RecordingStream(APPLICATION, recording_id=str(uuid.uuid4()))
        with with_utf8_name(partial) as named:
            rec.save(named)
        rec.send_recording_name("figures")
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        columns.send_reconstruction(rec, walk.reconstruction, walk.subject)
        tabs: list[Any] = []
        for one in figures:
            path = f"/figures/{one.stem}"
            rec.log(f"{path}/image", rr.EncodedImage(path=folder / f"{one.stem}.png"), static=True)
            caption = f"**{one.number}. {one.title}**\n\n{one.caption}"
            rec.log(f"{path}/caption", rr.TextDocument(plain(caption), media_type="text/markdown"), static=True)
            image = rrb.Spatial2DView(origin=f"{path}/image")
            text = rrb.TextDocumentView(origin=f"{path}/caption")
            tabs.append(rrb.Vertical(image, text, name=f"Figure {one.number}", row_shares=[4, 1]))
        views = [view_path("/world", one.name) for one in walk.located()]
        hall = rrb.Spatial3DView(name="Hall", origin="/world", contents=["/world/body/**", *views])
        focal = rrb.TimeSeriesView(name="Focal length [px]", contents=["/track/focal/**"])
        tabs.append(rrb.Vertical(hall, focal, name="Figures 11, 12 in time", row_shares=[2, 1]))
        rec.send_blueprint(rrb.Blueprint(rrb.Tabs(*tabs), collapse_panels=True))
        rec.disconnect()
