"""The sports hall: 30 x 20 x 8 m of textured surfaces and furniture, and the calibration object in it.

Read in this order: `gym` (builds the hall, its light and the calibration object), `scenery` (places panels, boxes and
bars in the MuJoCo model), `surfaces` (walls, floor, carpet, ceiling), `furniture` (things off the walls), `fittings`
(posters, doors, signs), `wallpaper` (the user's pictures on walls), `textures` (the canvas that all are painted on).
"""
