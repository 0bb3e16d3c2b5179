"""Shoot, reconstruct, score, show. The only place that knows both the estimate and the truth."""

import os

# Rerun's own lines on stderr. What goes wrong with a recording is checked, and said in one line, by pzcap.rerun_log.
os.environ.setdefault("RUST_LOG", "off")
