"""Steps a second of ManiSkill's PickCube with a wrist camera, one environment on the CPU.

Run by env_speed.py in a Python of its own, which has mani-skill installed (3.0.1 was measured). The
camera is of our size; depth and segmentation are rendered, as a grasping policy needs them.
"""

import sys
import time

import gymnasium
import mani_skill.envs  # noqa: F401  # pyright: ignore[reportMissingImports]  registers them


def main(num_steps: int, pictures: bool) -> None:
    """Print steps a second with random actions, after a warm-up."""
    env = gymnasium.make(
        "PickCube-v1",
        num_envs=1,
        robot_uids="panda_wristcam",
        obs_mode="depth+segmentation" if pictures else "state",
        sim_backend="cpu",
        sensor_configs={"width": 112, "height": 112},
    )
    env.reset(seed=0)
    for counted in (max(3, num_steps // 10), num_steps):
        start = time.perf_counter()
        for _ in range(counted):
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            if bool(terminated) or bool(truncated):
                env.reset()
        seconds = time.perf_counter() - start
    print(f"steps_per_second={num_steps / seconds}")


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2] == "pictures")
