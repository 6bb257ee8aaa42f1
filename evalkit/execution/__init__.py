"""Run experiments: scheduler, executors, one subprocess per run, job store, timing, environment."""
