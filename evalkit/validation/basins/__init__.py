"""From how far off a guess does a registration still find the truth?"""
