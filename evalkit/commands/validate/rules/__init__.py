"""Rules every back end and data set must keep."""
