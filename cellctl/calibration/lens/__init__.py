"""What a lens does to a picture, measured on any folder of pictures of a flat board. Pure: arrays in, results out.

`boards` describes boards, `sightings` finds one in a picture (`chessboard`, `charuco`, and the dot board's finder;
`corners` makes corners sub-pixel). `pinhole` (Zhang's start in `zhang`) and `telecentric` are the two models, `fit`
adjusts either robustly, `solve` leaves out what is wrong and judges, `quality` says how good it is, `report` shows it.
"""
