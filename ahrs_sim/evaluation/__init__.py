"""How wrong an attitude is, and whether its claimed covariance is consistent with that; knows no log and no plot.

metrics         attitude errors and their statistics
consistency     NEES and NIS
bootstrap       confidence intervals of paired differences
sync            time shift and constant rotation between two attitude histories
"""
