"""Motion capture with cameras that stand still, pan and zoom: footage in, cameras and motion out.

The spine, in reading order, 3,900 lines; everything else is a leaf that one may skip:

    types                                              conventions, and every record that crosses a stage
    pipeline, views                                    the stages, and the one loop over the frames (what a stage
                                                       yields is a record of `events`)
    geometry.lens, geometry.camera                     from a direction to a pixel
    solver.robust, solver.gauss_newton                 how everything here is fitted
    calibration.parameters, .bundle_adjustment, .photometric_bundle_adjustment, .fitting, .stitching, .calibrate
                                                       an empty hall becomes a panorama
    localisation.photometric_alignment, .localise      a frame finds itself on it
    segmentation.foreground                            the athlete is cut out
    body.skeleton, tracking.pose_objective             what images say of a pose
    tracking.frame_tracker, .interval_solver, .batch_refinement
                                                       from keyframe to keyframe

Beside the stages stand the modules at the top that prepare them and judge what they find (`camera_set`, `look_ahead`,
`starting_poses`, `without_object`, `assembly`, `plausibility`, `camera_notes`, `frame_slips`), and
`initialisation`, for footage without keyframes by hand.

Around the method stand the tools that a crew uses (`synchronisation`, `command`, `editor`, `export`, `scoring`),
`extras` for what one comparison or one experiment needs, and `viewer`, which shows records in Rerun; the method imports
none of these.
"""
