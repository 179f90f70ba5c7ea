import numpy as np
import pytest

from track_range.detection.classes import (
    COCO_CATEGORIES,
    COCO_CLASSES,
    ROAD_CLASSES,
    SAME_OBJECT_GROUP,
    ClassNameError,
    fully_known,
    map_to_road_classes,
    road_class_id,
    road_class_ids,
)


def test_names_and_synonyms():
    assert road_class_ids(["car", " Pedestrian "]).tolist() == [0, 2]
    assert road_class_ids([]).tolist() == []
    assert [road_class_id(name) for name in ROAD_CLASSES] == list(range(8))


def test_unknown_name_suggests_the_nearest():
    with pytest.raises(ClassNameError, match="'trcuk': did you mean 'truck'"):
        road_class_ids(["trcuk"])
    with pytest.raises(ValueError, match=r"0 person.*2 car.*7 traffic sign"):
        road_class_id("tram")


def test_coco_categories_by_id():
    by_id = {
        1: "person",
        3: "car",
        10: "traffic light",
        13: "stop sign",
        44: "bottle",
        67: "dining table",
        90: "toothbrush",
    }
    assert {i: COCO_CATEGORIES[i] for i in by_id} == by_id  # ids in COCO's instances_val2017.json
    assert tuple(name for name in COCO_CATEGORIES if name != "N/A") == COCO_CLASSES


def test_coco_maps_onto_all_road_classes():
    road = map_to_road_classes(COCO_CLASSES)
    assert len(COCO_CLASSES) == 80
    assert {COCO_CLASSES[i]: ROAD_CLASSES[road[i]] for i in np.flatnonzero(road >= 0)} == {
        "person": "person",
        "bicycle": "bicycle",
        "car": "car",
        "motorcycle": "motorcycle",
        "bus": "bus",
        "truck": "truck",
        "traffic light": "traffic light",
        "stop sign": "traffic sign",
    }
    assert len(SAME_OBJECT_GROUP) == len(ROAD_CLASSES)


def test_stop_signs_are_not_all_traffic_signs():
    assert not fully_known(["Stop Sign", "van", "person_sitting", "cyclist"]).any()
    assert np.flatnonzero(
        fully_known(["stop sign", "traffic sign", "pedestrian", "zebra"])
    ).tolist() == [0, 7]


@pytest.mark.parametrize(
    ("names", "road_class"),
    [
        (
            "Person people rider Pedestrian TYPE_PEDESTRIAN human.pedestrian.adult Man "
            "person_sitting",
            "person",
        ),
        ("Bicycle bike Cyclist TYPE_CYCLIST vehicle.bicycle object--vehicle--bicycle", "bicycle"),
        (
            "Car vehicle Van TYPE_VEHICLE Taxi vehicle.car vehicle.emergency.police other-vehicle "
            "suv",
            "car",
        ),
        ("motor motorbike Motorcycle object--vehicle--motorcycle motor_bike", "motorcycle"),
        ("Bus vehicle.bus.rigid Buses big_bus bus-l-", "bus"),
        ("Cars small_car", "car"),
        ("Pedestrians Persons children", "person"),
        ("biker Bicycles", "bicycle"),
        (
            "Lorry truck trailer caravan construction_vehicle vehicle.construction Heavy_Truck "
            "Lorries truck-xl- heavy_vehicle LARGE_VEHICLE",
            "truck",
        ),
        ("traffic_light traffic-light TrafficLight", "traffic light"),
        ("sign Traffic_Sign Stop_sign TYPE_SIGN", "traffic sign"),
    ],
)
def test_names_of_other_data_sets(names, road_class):
    """BDD100K, Cityscapes, KITTI, VisDrone, UA-DETRAC, Open Images, nuScenes, Waymo and
    Mapillary."""
    assert {ROAD_CLASSES[i] for i in map_to_road_classes(names.split())} == {road_class}


def test_names_that_are_no_road_class():
    names = (
        "Tram",
        "Misc",
        "DontCare",
        "others",
        "ignored region",
        "traffic_cone",
        "movable_object.barrier",
        "train",
    )
    names += (
        "static_object.bicycle_rack",
        "tricycle",
        "awning-tricycle",
        "TYPE_UNKNOWN",
        "",
        "license plate",
        "object--vehicle--boat",
        "object--vehicle--on-rails",
        "vehicle.train",
        "big vehicle",
    )
    assert (map_to_road_classes(names) == -1).all()
    assert not fully_known(["rider", "Construction_Vehicle", "taxi"]).any()
    assert np.flatnonzero(fully_known(["Vehicle", "lorry"])).tolist() == [2, 5]
