"""The planar arm: two links that turn about a fixed base among round obstacles, seen from above.

The workspace is the unit square, x to the right and y up; the base is its middle. An action turns
both joints, in units of `displacement`. Nothing has mass: a step is made in equal parts, and a part
that would push a link into an obstacle or a joint past its limit is made by one joint alone, or not
at all. Obstacles change with the episode and never reach into the circle of the first link, so a
folded arm always gets past them.
"""
