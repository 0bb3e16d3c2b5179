"""`pzcap check`: what to shoot again while the hall is still rented.

In reading order: `run` (the whole), `views` (how two pictures of one camera lie to each other), then a module each for
reference image, sweep, zoom run and motion, `body_check` (the athlete at the keyframes), `forecast`, and `page`.
"""
