"""Where the cameras are, and how well we know it. Pure: arrays in, results out.

`dots` finds the dot board in a picture, `plan` says where the robot goes, `hand_eye` solves, `tool_centre` checks the
result by pure rotations, `report` says how good it is. `scara` holds the model they share, `motion` what a set of
poses must offer, `accuracy` what a covariance means in um, `plane_map` the camera that results. `lens/` finds out what
a lens does to pictures, on any folder of them; `adjustment` is the least squares that all of these share.
"""
