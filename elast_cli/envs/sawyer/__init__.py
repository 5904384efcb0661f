"""The Sawyer family: a robot arm over a table, seen by a camera (after Metaworld's tasks).

The scenes are Metaworld's, and MuJoCo steps them. An action moves the hand along x, y and z, in
units of `displacement`, inside a box. Where the gripper matters, a fourth number closes it (+1) or
opens it (-1). Four things differ from Metaworld, so that one image shows the whole state:

- a step lasts until the arm has come to rest;
- the hand's next place is counted from where the hand is, not from where it was sent;
- gravity does not act on the arm;
- a torque that leaves the hand where it is draws the seven joints to one posture.

The camera and the renderer are ours, too.
"""
