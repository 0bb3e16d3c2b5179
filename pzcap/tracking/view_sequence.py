"""The views of an interval, instant after instant, and the objectives that they make once the body moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pzcap.body.kinematics import forward
from pzcap.body.skeleton import Body
from pzcap.tracking.observation import Views
from pzcap.tracking.pixel_time import sequence_rates
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.types import Pose


@dataclass(frozen=True, slots=True, eq=False)
class ViewSequence:
    """Views of successive instants, evenly apart."""

    views: Sequence[Views]
    period: float  # frame periods from an instant to the next

    def objectives(self, body: Body, poses: Sequence[Pose]) -> list[PoseObjective]:
        """Of each instant, the body moving as the ``poses`` say."""
        rates = sequence_rates([forward(body, pose) for pose in poses], self.period)
        return [PoseObjective(body, each, own) for each, own in zip(self.views, rates, strict=True)]

    def corrected(self, objectives: Sequence[PoseObjective]) -> ViewSequence:
        """The sequence with the cameras and clocks that the ``objectives`` have come to."""
        return replace(self, views=[each.views for each in objectives])

    def part(self, instants: Sequence[int]) -> ViewSequence:
        """Consecutive ``instants`` of it."""
        return replace(self, views=[self.views[t] for t in instants])
