"""Listens with libraries of others to what facewire-bridge publishes, and prints what it finds as JSON on lines.

listen.py mqtt PORT TOPIC            messages, by paho-mqtt
listen.py dds DOMAIN TYPE TOPIC...   samples of topics of one type, by CycloneDDS, with the quality that ROS asks for
"""

import dataclasses
import json
import sys
import time


def mqtt(port, topic):
    """Prints whether a message was retained, its topic and its payload."""
    from paho.mqtt import client as paho

    def connected(client, _data, _flags, _reason, _properties):
        client.subscribe(topic, qos=1)

    def received(_client, _data, message):
        print(json.dumps([message.retain, message.topic, message.payload.decode()]), flush=True)

    client = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=paho.MQTTv311)
    client.on_connect, client.on_message = connected, received
    client.connect("127.0.0.1", int(port))
    client.loop_forever()


def types():
    """Returns the message types of ROS by name, as their IDL defines them."""
    from cyclonedds.idl import IdlStruct, make_idl_struct
    from cyclonedds.idl.types import array, byte, float32, float64, int32, sequence, uint32

    made = {}

    def message(kind, **fields):
        package, short = kind.split("/")
        made[kind] = make_idl_struct(short, f"{package}::msg::dds_::{short}_", fields)
        return made[kind]

    stamp = message("builtin_interfaces/Time", sec=int32, nanosec=uint32)
    header = message("std_msgs/Header", stamp=stamp, frame_id=str)
    floats = sequence[float64]
    message("std_msgs/Bool", data=bool)
    message("sensor_msgs/JointState", header=header, name=sequence[str], position=floats, velocity=floats, effort=floats)
    point = message("geometry_msgs/Point", x=float64, y=float64, z=float64)
    vector = message("geometry_msgs/Vector3", x=float64, y=float64, z=float64)
    turn = message("geometry_msgs/Quaternion", x=float64, y=float64, z=float64, w=float64)
    pose = message("geometry_msgs/Pose", position=point, orientation=turn)
    message("geometry_msgs/PoseStamped", header=header, pose=pose)
    transform = message("geometry_msgs/Transform", translation=vector, rotation=turn)
    stamped = message("geometry_msgs/TransformStamped", header=header, child_frame_id=str, transform=transform)
    message("tf2_msgs/TFMessage", transforms=sequence[stamped])
    pair = message("diagnostic_msgs/KeyValue", key=str, value=str)
    status = message("diagnostic_msgs/DiagnosticStatus", level=byte, name=str, message=str, hardware_id=str, values=sequence[pair])
    message("diagnostic_msgs/DiagnosticArray", header=header, status=sequence[status])
    message("hri_msgs/IdsList", header=header, ids=sequence[str])
    message("hri_msgs/FacialActionUnits", header=header, intensity=array[float32, 99], confidence=array[float32, 99])
    return made


def dds(domain, kind, *topics):
    """Prints each sample with its topic."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    participant, kind = DomainParticipant(int(domain)), types()[kind]
    durability = Policy.Durability.TransientLocal if topics[0].endswith("/face") else Policy.Durability.Volatile
    quality = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(100), durability)
    readers = [(topic, DataReader(participant, Topic(participant, f"rt{topic}", kind), qos=quality)) for topic in topics]
    while True:
        for topic, reader in readers:
            for sample in reader.take(N=100):
                print(json.dumps([topic, dataclasses.asdict(sample)]), flush=True)
        time.sleep(0.01)


{"mqtt": mqtt, "dds": dds}[sys.argv[1]](*sys.argv[2:])
