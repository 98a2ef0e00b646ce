"""Many flights: on worker processes or a cluster, against a baseline, as Monte Carlo.

pool            flights on a pool of workers
check           accuracy regression against a baseline
campaign        many flights with varied values; campaign_report: their statistics
tuning          search for an estimator's settings over flights
budget          how much each sensor error contributes
"""
