"""The cable family: a cable that is moved by one end among walls, seen from above.

The workspace is the unit square, x to the right and y up. The cable is a chain of rigid segments in
pymunk, joined by rotary springs that have some friction; it lies on a surface that brakes it so
strongly that nothing goes on moving by itself. An action is the velocity of one end, the head, in
units of `displacement`; the head is pulled there by a limited force, so that walls stop it. The
cable may lie across itself. A member of the family is a set of rectangles: data; in CableParam it
changes with the episode.
"""
