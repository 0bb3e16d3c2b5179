"""Constants of the editor that no user sets, a table a topic."""

from __future__ import annotations

from typing import Final, NamedTuple


class PosingTuning(NamedTuple):
    """The body fitted to clicks."""

    tape_m: float = 0.010  # by which a handle of the body as taped stands off from where a person takes it to be
    limit_rad: float = 0.02  # standard deviation beyond a joint's limits
    strongest: float = 8.0
    """Sigmas; a hand that is further off pulls no harder, or a joint would give way beyond its limits."""
    grip: float = 2.0  # sigmas; a pose that is left by more is held less
    twist_deg: float = 45.0  # standard deviation of an upper arm's or a thigh's twist
    begun: float = 3.0  # times as loosely a pose is held that is none of this instant
    nearest_m: float = 0.2  # before the camera; what is nearer, or behind it, no click bears on
    ready_m: float = 0.12  # a pose whose joints are all known to this is one to track from
    longest: float = 2.0  # of a step, in what each degree of freedom gives way by
    settled: float = 1e-3  # relative fall of the cost that is not worth another step
    first_damping: float = 1e-2  # of Levenberg and Marquardt, in what each degree of freedom gives way by
    least_damping: float = 1e-5
    small_damping: float = 0.1  # a step that is damped more may be short although there is far to go
    most_damping: float = 1e6  # beyond which no step makes the fit better
    at_leisure: int = 60  # steps, at most
    tried: int = 20  # steps of another start
    most: float = 0.85  # share of the clicks that are likely to be right
    doubted: float = 1.2  # squared sigmas by which these are missed by a pose that is doubted
    clearly: float = 2.0  # squared sigmas by which another must fit better


class FootageTuning(NamedTuple):
    """Pictures and silhouettes of a frame."""

    before: int = 8  # frames that are kept before a wanted one
    on: int = 12  # frames that are decoded to go on rather than to begin anew
    quality: int = 92  # of JPEG
    expected_sigma_m: float = 0.15  # of a pose, where its silhouette is looked for
    margin: float = 0.4  # around it, in sizes of the body
    edge_px: float = 0.7  # by which an outline may be simplified


class EditsTuning(NamedTuple):
    """The pose that a frame begins with."""

    least_m: float = 1e-3  # standard deviation of a tracked joint
    copy_reach: int = 90  # frames; a pose from further away tells nothing


class ResolveTuning(NamedTuple):
    """An interval that is tracked anew. Frames, where nothing else is said."""

    kept: int = 20  # solutions, the latest, that undoing the pose that they were made with undoes
    reach: int = 100  # beyond the last keyframe
    end_from: int = 15  # from where a hand has posed the body to one that it was tracked in
    end_to: int = 45


class WorkspaceTuning(NamedTuple):
    """Commands."""

    drag_steps: int = 6  # of the fit, while a handle is dragged


class ShowingTuning(NamedTuple):
    """Data of the page."""

    suggested: int = 6  # frames to pose next
    helped: int = 4  # frames on either side that a keyframe helps
    outline_px: float = 200.0  # length of the body where its outline is found


POSING: Final = PosingTuning()
FOOTAGE: Final = FootageTuning()
EDITS: Final = EditsTuning()
RESOLVE: Final = ResolveTuning()
WORKSPACE: Final = WorkspaceTuning()
SHOWING: Final = ShowingTuning()
