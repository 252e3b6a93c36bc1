"""Listens with libraries of others to what facewire-bridge publishes, and prints what it finds as JSON on lines.

listen.py mqtt PORT TOPIC    messages, by paho-mqtt
"""

import json
import sys


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


{"mqtt": mqtt}[sys.argv[1]](*sys.argv[2:])
