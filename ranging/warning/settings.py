"""WarningSettings: thresholds of the collision warning, without NumPy, for help pages."""

from dataclasses import dataclass

from track_range.foundation.schemas.validation import check_numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class WarningSettings:
    """Settings of the collision warning.

    Example:
        >>> import track_range as tr
        >>> tr.WarningSettings(front_m=2.0, on_probability=0.5).off_probability
        0.1

    The thresholds of the alarm were chosen on simulated
    drives without images of all scenarios (seeds 0 to 7 with stereo, 0 to 5 with one camera) and on
    rendered drives (30 of the seeds 0 to 29), for warnings at least 2.1 s before contacts and few
    false alarms; the probabilities of an alarm on drives without images (seeds 0 to 6, harmless
    ones also 200 to 206) and on KITTI, for few false alarms: real drivers avoid nearly all contacts
    that are predicted as if they did not react.
    Sizes of the ego vehicle are taken from the simulation.

    Attributes:
        horizon_s: a contact within this time counts.
        on_probability: an alarm starts when the probability of contact is at least this, where
            hard braking is needed; where less is needed, the threshold is higher
            (`sequential_test`).
        person_probability: the same for people.
        off_probability: an alarm ends when the probability has been below this for half a second.
        min_on_s: shortest time for which this has to hold before an alarm; the probability already
            needs time to rise.
        uncertain_on_s: the same; the longer one counts. In earlier versions, it was that of
            uncertain distances.
        min_closing_mps: smallest closing speed of an alarm.
        front_m: distance from the camera to the front of the ego vehicle.
        ego_width_m: width of the ego vehicle.
        ego_length_m: length of the ego vehicle.
        min_deceleration_mps2: an alarm requires that at least this deceleration is needed after
            `reaction_s`, more than in normal driving.
        reaction_s: time before the driver brakes.
    """

    horizon_s: float = 3.5
    on_probability: float = 0.75
    person_probability: float = 0.4
    off_probability: float = 0.1
    min_on_s: float = 0.0
    uncertain_on_s: float = 0.0
    min_closing_mps: float = 2.0
    front_m: float = 1.5
    ego_width_m: float = 1.8
    ego_length_m: float = 4.2
    min_deceleration_mps2: float = 2.5
    reaction_s: float = 1.0

    def __post_init__(self) -> None:
        check_numbers(self)
