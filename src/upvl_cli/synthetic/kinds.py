"""All kinds of things that can be met in the city, by name."""

from __future__ import annotations

from upvl_cli.synthetic import buses, cars, furniture, people, riders, services, trucks, vans, works
from upvl_cli.synthetic.kind import CYCLIST, OTHER, PEDESTRIAN, SIGN, VEHICLE, Kind

_DRIVING = ("lane",)
_CAR = ("lane", "parked")
_WALKING = ("pavement", "crossing")
_STANDING = ("roadside",)
_STILL = (0.0, 0.0)

_CARS = (
    Kind("sedan", ("car", "saloon", "saloon car", "passenger car", "automobile", "family car", "vehicle"),
         VEHICLE, cars.sedan, (5.0, 14.0), _CAR, 5.0),
    Kind("hatchback", ("small car", "compact car", "city car", "five-door car", "car", "vehicle"),
         VEHICLE, cars.hatchback, (5.0, 14.0), _CAR, 4.0),
    Kind("suv", ("sport utility vehicle", "off-road car", "four-by-four", "4x4", "jeep", "crossover", "car"),
         VEHICLE, cars.suv, (5.0, 14.0), _CAR, 3.0),
    Kind("pickup", ("pickup truck", "pick-up", "ute", "car with an open bed", "flatbed pickup", "vehicle"),
         VEHICLE, vans.pickup, (5.0, 14.0), _CAR, 1.0),
    Kind("van", ("delivery van", "panel van", "transporter", "minibus", "cargo van", "vehicle"),
         VEHICLE, vans.van, (5.0, 13.0), _CAR, 1.5),
    Kind("taxi", ("cab", "yellow cab", "taxicab", "minicab", "car for hire", "car with a taxi sign"),
         VEHICLE, services.taxi, (5.0, 14.0), _CAR, 0.8),
    Kind("police car", ("patrol car", "cop car", "squad car", "police vehicle", "emergency vehicle"),
         VEHICLE, services.police_car, (6.0, 16.0), _CAR, 0.5),
)  # fmt: skip
_TRUCKS = (
    Kind("ambulance", ("emergency ambulance", "rescue vehicle", "paramedic vehicle", "emergency vehicle"),
         VEHICLE, services.ambulance, (6.0, 16.0), _CAR, 0.4),
    Kind("box truck", ("truck", "lorry", "box lorry", "moving van", "delivery truck", "removal van"),
         VEHICLE, trucks.box_truck, (4.0, 12.0), _CAR, 0.8),
    Kind("articulated truck",
         ("articulated lorry", "semi", "semi-trailer truck", "tractor-trailer", "eighteen-wheeler", "big rig",
          "truck with a trailer", "heavy goods vehicle"),
         VEHICLE, trucks.articulated_truck, (4.0, 12.0), _DRIVING, 0.5),
    Kind("dump truck", ("tipper", "tipper lorry", "tipper truck", "dumper", "truck with sand", "lorry"),
         VEHICLE, trucks.tipper, (4.0, 11.0), _DRIVING, 0.4),
    Kind("concrete mixer", ("cement mixer", "cement truck", "mixer lorry", "concrete truck", "truck with a drum"),
         VEHICLE, trucks.concrete_mixer, (4.0, 11.0), _DRIVING, 0.3),
    Kind("garbage truck", ("refuse lorry", "bin lorry", "rubbish truck", "dustcart", "trash truck", "waste truck"),
         VEHICLE, trucks.garbage_truck, (2.0, 9.0), _CAR, 0.3),
    Kind("fire truck", ("fire engine", "fire appliance", "firefighting vehicle", "ladder truck", "fire brigade"),
         VEHICLE, works.fire_truck, (6.0, 14.0), _DRIVING, 0.3),
    Kind("tractor", ("farm tractor", "agricultural tractor", "farm vehicle", "agricultural vehicle"),
         VEHICLE, works.tractor, (3.0, 9.0), _CAR, 0.3),
    Kind("crane", ("mobile crane", "crane truck", "truck crane", "lorry with a boom", "construction vehicle"),
         VEHICLE, works.crane, (3.0, 9.0), _DRIVING, 0.25),
    Kind("bus", ("city bus", "coach", "public bus", "transit bus", "public transport", "passenger bus"),
         VEHICLE, buses.bus, (4.0, 12.0), _DRIVING, 0.7),
    Kind("double-decker bus", ("double-decker", "two-storey bus", "london bus", "bus with two floors", "tall bus"),
         VEHICLE, buses.double_decker, (4.0, 11.0), _DRIVING, 0.3),
    Kind("school bus", ("yellow bus", "yellow school bus", "schoolbus", "bus for pupils", "bus for children"),
         VEHICLE, buses.school_bus, (4.0, 11.0), _DRIVING, 0.35),
    Kind("tram", ("streetcar", "trolley", "light rail", "tramcar", "street railway", "rail vehicle"),
         VEHICLE, buses.tram, (3.0, 11.0), _DRIVING, 0.3),
)  # fmt: skip
_PEOPLE = (
    Kind("adult", ("pedestrian", "person", "man", "woman", "walker", "passer-by", "human"),
         PEDESTRIAN, people.adult, (0.8, 1.8), _WALKING, 5.0),
    Kind("child", ("kid", "boy", "girl", "little child", "schoolchild", "small person", "youngster"),
         PEDESTRIAN, people.child, (0.7, 1.8), _WALKING, 1.5),
    Kind("jogger", ("runner", "running person", "person jogging", "person in sportswear", "sporty person"),
         PEDESTRIAN, people.jogger, (2.2, 3.6), _WALKING, 0.6),
    Kind("person with umbrella", ("umbrella", "person under an umbrella", "parasol", "someone with a brolly"),
         PEDESTRIAN, people.person_with_umbrella, (0.8, 1.6), _WALKING, 0.5),
    Kind("pram", ("stroller", "pushchair", "baby carriage", "buggy", "person with a pram", "parent with a baby"),
         PEDESTRIAN, people.pram, (0.7, 1.5), _WALKING, 0.6),
    Kind("wheelchair user", ("wheelchair", "person in a wheelchair", "disabled person", "seated person"),
         PEDESTRIAN, people.wheelchair_user, (0.6, 1.6), _WALKING, 0.5),
    Kind("dog", ("animal", "pet", "puppy", "hound", "canine", "four-legged animal"),
         OTHER, people.dog, (0.6, 2.0), ("pavement",), 0.8),
    Kind("scooter rider", ("e-scooter", "electric scooter", "kick scooter", "person on a scooter", "push scooter"),
         PEDESTRIAN, riders.scooter_rider, (2.5, 6.0), ("lane", "pavement"), 0.5),
    Kind("cyclist", ("bicycle", "bike", "bicyclist", "person on a bicycle", "push bike", "bike rider", "rider"),
         CYCLIST, riders.cyclist, (3.0, 7.0), _DRIVING, 1.2),
    Kind("motorcyclist", ("motorcycle", "motorbike", "biker", "person on a motorbike", "motorcycle rider"),
         VEHICLE, riders.motorcyclist, (5.0, 15.0), _DRIVING, 0.8),
)  # fmt: skip
_FURNITURE = (
    Kind("traffic cone", ("cone", "pylon", "orange cone", "road cone", "safety cone", "construction cone"),
         OTHER, furniture.traffic_cone, _STILL, _STANDING, 1.5),
    Kind("barrier", ("construction barrier", "road barrier", "barricade", "striped board", "roadworks fence"),
         OTHER, furniture.barrier, _STILL, _STANDING, 1.0),
    Kind("wheelie bin", ("trash can", "garbage can", "rubbish bin", "dustbin", "waste bin", "waste container"),
         OTHER, furniture.wheelie_bin, _STILL, _STANDING, 1.2),
    Kind("rubbish bags", ("garbage bags", "trash bags", "bin bags", "sacks of rubbish", "pile of trash", "litter"),
         OTHER, furniture.rubbish_bags, _STILL, _STANDING, 0.4),
    Kind("bench", ("park bench", "street bench", "wooden bench", "seat", "place to sit"),
         OTHER, furniture.bench, _STILL, _STANDING, 0.8),
    Kind("fire hydrant", ("hydrant", "fireplug", "water hydrant", "fire plug", "water outlet"),
         OTHER, furniture.fire_hydrant, _STILL, _STANDING, 0.6),
    Kind("post box", ("mailbox", "letter box", "pillar box", "postbox", "box for letters"),
         OTHER, furniture.post_box, _STILL, _STANDING, 0.5),
    Kind("bollard", ("post", "short post", "pole", "traffic post", "street post"),
         OTHER, furniture.bollard, _STILL, _STANDING, 1.0),
    Kind("advertising column", ("morris column", "poster pillar", "litfass column", "round billboard", "kiosk"),
         OTHER, furniture.advertising_column, _STILL, _STANDING, 0.3),
    Kind("stop sign", ("sign", "red octagon", "octagonal sign", "halt sign", "red stop sign"),
         SIGN, furniture.stop_sign, _STILL, _STANDING, 0.6),
    Kind("traffic sign", ("road sign", "street sign", "sign", "speed limit sign", "warning sign", "signpost"),
         SIGN, furniture.traffic_sign, _STILL, _STANDING, 1.0),
    Kind("traffic light", ("traffic signal", "stoplight", "signal lights", "stop light", "red light"),
         OTHER, furniture.traffic_light, _STILL, _STANDING, 0.6),
)  # fmt: skip

KINDS: dict[str, Kind] = {kind.name: kind for kind in (*_CARS, *_TRUCKS, *_PEOPLE, *_FURNITURE)}
# What a flow benchmark calls a car; the other vehicles are larger ones.
CARS = tuple(kind.name for kind in _CARS)
