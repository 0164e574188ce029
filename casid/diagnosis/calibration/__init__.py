"""The false-alarm rate of a diagnosis, by parametric bootstrap.

`false_alarm_rate.calibrate` draws records as the fitted model gives them (`null_records`), has each
diagnosed (`null_runs`), and counts the alarms in a `calibration.Calibration`.
"""
