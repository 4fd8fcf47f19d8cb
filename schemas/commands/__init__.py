"""What recorder and evaluator need to be commands."""
