"""Results in the formats of other tools, a module each; docs/formats says what each keeps and loses.

`formats` lists them and `write` writes one. `take` is what all of them are written from, `axes` the change of axes and
angles, `virtual_cameras` the fixed cameras without distortion for tools that know no others. Libraries that a format is
written by are imported when it is written, and not before.
"""
