"""Where a camera is on, or beside, a robot that turns in space: AX = XB and CX = XD in all six degrees of freedom.

`table` reads poses from CSV, `align` brings two streams to one time, `freedom` says what the motion can tell and what
it cannot, `closed_form` starts, `adjust` refines, `solve` judges and refuses, `report` puts it into words, `peers`
asks OpenCV for its opinion. For a SCARA, whose rotations are all about one direction, there is `hand_eye` instead.
"""
