"""MuJoCo Warp with nothing around it: python -m benchmarks.bare_warp MODEL N_ENV WARMUP STEPS NCONMAX NJMAX."""

from __future__ import annotations

import sys
import time
from pathlib import Path


def main() -> None:
    """Step and print env-steps/s."""
    import mujoco
    import mujoco_warp as mjw
    import warp as wp

    path, *numbers = sys.argv[1:]
    n_env, warmup, steps, nconmax, njmax = map(int, numbers)
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    compiled = mujoco.MjModel.from_xml_string(Path(path).read_text())
    model = mjw.put_model(compiled)
    data = mjw.make_data(compiled, nworld=n_env, nconmax=nconmax, njmax=njmax)
    mjw.step(model, mjw.make_data(compiled, nworld=1, nconmax=nconmax, njmax=njmax))  # builds the kernels
    if wp.get_device().is_cuda:
        with wp.ScopedCapture() as captured:
            mjw.step(model, data)

    def run(count: int) -> float:
        began = time.perf_counter()
        for _ in range(count):
            if wp.get_device().is_cuda:
                wp.capture_launch(captured.graph)
            else:
                mjw.step(model, data)
        wp.synchronize()
        return time.perf_counter() - began

    run(warmup)
    print(n_env * steps / run(steps))


if __name__ == "__main__":
    main()
