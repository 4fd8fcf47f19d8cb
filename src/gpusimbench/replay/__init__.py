"""gsb-replay: recorded actions, fed to an environment that is made again; the recorder steps, the evaluator judges."""
