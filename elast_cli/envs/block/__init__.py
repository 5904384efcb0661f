"""The block family: a square block that is pushed about among walls, seen from above.

The workspace is the unit square, x to the right and y up. An action is a displacement in units of
`displacement`, per axis; pymunk moves the block at constant velocity for one step and lets it
slide along what it touches, without friction or rotation. A stream carries the block along by a
drift, added to the displacement of every step that begins with the centre in it. A member of the
family is a set of rectangles: data; in BlockParam it changes with the episode.
"""
