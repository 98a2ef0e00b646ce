"""Settings of the navigator."""

from estimators.records import settings_type
from estimators.settings import Setting
from estimators.turned import FIELD_OFF

SETTINGS = {
    "align_s": Setting(20.0, "s, stationary stretch that is averaged", minimum=1.0, maximum=3600.0),
    "wait_s": Setting(60.0, "s, wait for it so long, then align coarsely", minimum=1.0, maximum=3600.0),
    "heading_aid": Setting(True, "use the dual-antenna heading where there is one"),
    "prior_share": Setting(1.0, "of the data sheet's scale, misalignment, hard and soft iron", minimum=0.0),
    "gyro_noise": Setting(5e-4, "rad/s/sqrt(Hz), beside the data sheet's: vibration", minimum=0.0),
    "scale_share": Setting(0.02, "of the gyro's scale error, left as noise that grows with the rate", minimum=0.0),
    "jerk_share": Setting(2.0, "of the gyro's variance between samples, left as noise of one step", minimum=0.0),
    "accel_noise": Setting(0.05, "m/s2/sqrt(Hz), beside the data sheet's: vibration", minimum=0.0),
    "shake_share": Setting(2.0, "of the accelerometer's variance between samples, left as noise", minimum=0.0),
    "shake_most": Setting(0.5, "m/s2/sqrt(Hz), the most of that", minimum=0.0),
    "accel_share": Setting(0.002, "1/sqrt(Hz), besides, of the acceleration", minimum=0.0),
    "bias_time": Setting(300.0, "s, over which the biases walk by what the data sheet says of minutes", above=0.0),
    "velocity_share": Setting(1.0, "of the receiver's velocity sigma", above=0.0),
    "position_share": Setting(0.2, "of the receiver's position sigma, noise from fix to fix", above=0.0, maximum=1.0),
    "position_time": Setting(60.0, "s, over which the rest of a fix's error wanders", above=0.0),
    "gnss_time": Setting(0.002, "s, error of the time of a fix, from fix to fix", minimum=0.0),
    "late_sigma": Setting(0.2, "s, of a fix's delay that is not declared: learnt", minimum=0.0),
    "heading_share": Setting(0.4, "of the dual-antenna sigma, noise from one to the next", above=0.0, maximum=1.0),
    "heading_time": Setting(60.0, "s, over which the rest of it wanders", above=0.0),
    "mag_floor": Setting(0.0003, "of the field: its error at each use, however many readings", minimum=0.0),
    "mag_shake": Setting(12.0, "s2, of the gyro's variance between samples: besides, where it is shaken", minimum=0.0),
    "iron_time": Setting(300.0, "s, over which the hard iron walks by what the data sheet says of currents", above=0.0),
    "field_off": FIELD_OFF,
    "surprise": Setting(16.0, "innovation squared over its variance beyond which a measurement counts less", above=1.0),
}
VALUES = settings_type(SETTINGS)
