"""WarningSettings: thresholds of the collision warning, without imports, for help pages."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class WarningSettings:
    """Settings of the collision warning.

    Example:
        >>> import track_range as tr
        >>> tr.WarningSettings(front_m=2.0, on_probability=0.5).off_probability
        0.1

    The thresholds of the alarm and the standard deviations of the motion were chosen on simulated
    drives without images of all scenarios (seeds 0 to 7 with stereo, 0 to 5 with one camera) and on
    rendered drives (30 of the seeds 0 to 29), for warnings at least 2.1 s before contacts and few
    false alarms. The noise of the ego path was fitted to the shapes of the roads of seeds 0 to 11
    by maximum likelihood. Sizes of the ego vehicle are taken from the simulation.

    Attributes:
        horizon_s: a contact within this time counts.
        on_probability: an alarm starts when the probability of contact is at least this for
            `min_on_s`.
        person_probability: the same for people, whose lateral motion is less certain.
        off_probability: an alarm ends when the probability has been below this for `min_off_s`.
        min_on_s: shortest time above `on_probability` before an alarm.
        uncertain_on_s: the same where the distance is less certain than `certain_share`, as with
            one camera, and for vehicles that are beside the ego path or come towards the ego
            vehicle.
        certain_share: largest relative standard deviation of a certain distance.
        min_off_s: shortest time below `off_probability` before the end of an alarm.
        min_closing_mps: smallest closing speed of an alarm.
        min_track_s: shortest time for which the probability has been known, against tracks of false
            boxes, and tracks that change to another object.
        min_person_s: the same for people, who appear from behind parked cars.
        max_closing_sigma_mps: largest standard deviation of the closing speed; above, the
            probability is unknown.
        cut_in_headway_s: headway below which a vehicle that cuts in starts an alarm, even if it is
            not slower.
        min_cut_in_gap_m: smallest gap of a cut-in; nearer boxes beside the ego vehicle are cut by
            the image border.
        cut_in_ahead_s: a vehicle cuts in if it was beside the path and will be in it after this
            time.
        cut_in_probability: smallest probability that it will be in the path.
        max_cut_in_mps: largest speed at which it may draw away.
        drift_s: time in which the error of a distance changes by its standard deviation; its change
            looks like speed.
        front_m: distance from the camera to the front of the ego vehicle.
        ego_width_m: width of the ego vehicle.
        ego_length_m: length of the ego vehicle.
        manoeuvre_s: time constant with which accelerations end.
        acceleration_mps2: standard deviation of the relative acceleration until contact.
        person_acceleration_mps2: standard deviation of the lateral acceleration of people.
        vehicle_acceleration_mps2: the same of all other road users.
        min_deceleration_mps2: an alarm requires that at least this deceleration is needed after
            `reaction_s`, more than in normal driving.
        reaction_s: time before the driver brakes.
        yaw_sigma_rad_s: standard deviation of the yaw rate of the ego vehicle, where it is known.
        unknown_lateral_mps2: standard deviation of its lateral acceleration, where the yaw rate is
            not known.
        lateral_jerk_noise: random walk of the lateral jerk of the ego path, m/s^3 per square root
            of a second.
        winding_noise: the same per m/s^2 of recent lateral acceleration, since winding roads go on
            winding.
        lateral_speed_mps: prior standard deviation of the lateral speed of vehicles relative to the
            ego path.
        static_lateral_mps: the same of static objects.
        oncoming_lateral_mps: the same of oncoming vehicles.
        person_lateral_mps: the same of people.
        person_along_mps: prior standard deviation of the speed of people along the road.
    """

    horizon_s: float = 3.5
    on_probability: float = 0.3
    person_probability: float = 0.2
    off_probability: float = 0.1
    min_on_s: float = 0.2
    uncertain_on_s: float = 1.0
    certain_share: float = 0.055
    min_off_s: float = 0.5
    min_closing_mps: float = 1.0
    min_track_s: float = 0.5
    min_person_s: float = 0.1
    max_closing_sigma_mps: float = 2.0
    cut_in_headway_s: float = 0.6
    min_cut_in_gap_m: float = 3.0
    cut_in_ahead_s: float = 1.0
    cut_in_probability: float = 0.8
    max_cut_in_mps: float = 1.5
    drift_s: float = 0.6
    front_m: float = 1.5
    ego_width_m: float = 1.8
    ego_length_m: float = 4.2
    manoeuvre_s: float = 3.0
    acceleration_mps2: float = 0.4
    person_acceleration_mps2: float = 0.2
    vehicle_acceleration_mps2: float = 0.15
    min_deceleration_mps2: float = 2.5
    reaction_s: float = 1.0
    yaw_sigma_rad_s: float = 0.005
    unknown_lateral_mps2: float = 0.4
    lateral_jerk_noise: float = 0.02
    winding_noise: float = 0.1
    lateral_speed_mps: float = 1.0
    static_lateral_mps: float = 0.15
    oncoming_lateral_mps: float = 0.3
    person_lateral_mps: float = 1.5
    person_along_mps: float = 1.5
