"""Listens with libraries of others to what facewire-bridge publishes, and prints what it finds as JSON on lines.

listen.py mqtt PORT TOPIC            messages, by paho-mqtt
listen.py dds DOMAIN TYPE TOPIC...   samples of topics of one type, by CycloneDDS, with the quality that ROS asks for
listen.py writers DOMAIN             topics and user data of writers that CycloneDDS finds, and of one of its own
listen.py router PORT                tokens of nodes and writers, by a router of eclipse-zenoh
listen.py zenoh PORT DOMAIN TYPE TOPIC   messages as rmw_zenoh reads them, by eclipse-zenoh, with hashes and CDR by rosbags
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


def writers(domain):
    """Prints the topic and the user data of each writer."""
    from cyclonedds import builtin
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    participant = DomainParticipant(int(domain))
    found = builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsPublication)
    topic = Topic(participant, "own", types()["std_msgs/Bool"])
    own = DataWriter(participant, topic, qos=Qos(Policy.Userdata(b"of its own")))
    while own:
        for writer in found.take(N=100):
            data = writer.qos[Policy.Userdata]
            print(json.dumps([writer.topic_name, data.data.decode() if data else ""]), flush=True)
        time.sleep(0.01)


def session(mode, way, port):
    """Returns a session of Zenoh that uses a port of this machine, and nothing else."""
    import zenoh

    config = zenoh.Config()
    for key, value in {"mode": mode, f"{way}/endpoints": [f"tcp/127.0.0.1:{port}"], "scouting/multicast/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def router(port):
    """Prints whether a token came or went, and its key."""

    def told(sample):
        print(json.dumps([str(sample.kind).removeprefix("SampleKind."), str(sample.key_expr)]), flush=True)

    routes = session("router", "listen", port)
    routes.liveliness().declare_subscriber("@ros2_lv/**", told, history=True)
    # Zenoh sends nothing that nobody takes.
    routes.declare_subscriber("**", lambda _sample: None)
    print("listens", flush=True)
    time.sleep(1e6)
    routes.close()


def zenoh(port, domain, kind, topic):
    """Prints each message with its number, its time in nanoseconds and its writer. The key has the hash of rosbags."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    from zenoh import ext

    known = get_typestore(Stores.ROS2_JAZZY)
    known.register(get_types_from_msg("std_msgs/Header header\nstring[] ids", "hri_msgs/msg/IdsList"))
    units = "std_msgs/Header header\nfloat32[99] intensity\nfloat32[99] confidence"
    known.register(get_types_from_msg(units, "hri_msgs/msg/FacialActionUnits"))
    package, short = kind.split("/")
    name = f"{package}/msg/{short}"

    def received(sample):
        number, time_ns, writer = ext.z_deserialize(tuple[ext.Int64, ext.Int64, bytes], sample.attachment)
        message = dataclasses.asdict(known.deserialize_cdr(sample.payload.to_bytes(), name))
        print(json.dumps([message, number, time_ns, writer.hex()], default=lambda array: array.tolist()), flush=True)

    key = f"{domain}{topic}/{package}::msg::dds_::{short}_/{known.hash_rihs01(name)}"
    history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1) if topic.endswith("/face") else None
    reader = session("peer", "connect", port)
    ext.declare_advanced_subscriber(reader, key, received, history=history)
    time.sleep(1e6)
    reader.close()


{"mqtt": mqtt, "dds": dds, "writers": writers, "router": router, "zenoh": zenoh}[sys.argv[1]](*sys.argv[2:])
