"""The second engine: the same robot, table and objects in MuJoCo, behind the seam of `World` and `Engine`.

Only this folder imports mujoco, and only once a world is built; cameras, kinematics and proofs are elsewhere.
"""
