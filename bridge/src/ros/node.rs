//! The program's node and its writers, by DDS or by Zenoh.

use std::{collections::BTreeSet, net::Ipv4Addr};

use nix::ifaddrs::getifaddrs;
use ros2_client::{
    Context, ContextOptions, MessageTypeName, Name, NodeName, NodeOptions, Publisher,
    qos::{Durability, History, QosProfile, WhenFull},
};
use serde::Serialize;

#[cfg(feature = "zenoh")]
use super::zenoh;
use super::{Failed, Kind, NODE};
use crate::{fleet::Shared, say, settings::Ros};

/// This program in the graph of ROS.
pub enum Node {
    /// With the addresses of this machine at the start, because RustDDS uses no networks that come later.
    Dds(Box<ros2_client::Node>, BTreeSet<Ipv4Addr>),
    #[cfg(feature = "zenoh")]
    Zenoh(zenoh::Node),
}

impl Node {
    #[cfg_attr(not(feature = "zenoh"), expect(unused_variables, reason = "only Zenoh waits for a router"))]
    pub fn open(settings: &Ros, shared: &Shared) -> Result<Self, Failed> {
        #[cfg(feature = "zenoh")]
        if let Some(endpoint) = settings.endpoint() {
            return Ok(Self::Zenoh(zenoh::Node::open(settings, endpoint?, shared)?));
        }
        let addresses = addresses();
        let context = Context::with_options(ContextOptions::new().domain_id(settings.domain()))?;
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        Ok(Self::Dds(Box::new(context.new_node(NodeName::new("/", NODE)?, options)?), addresses))
    }

    pub fn writer<M: Serialize>(&mut self, topic: &str, kind: &Kind) -> Result<Writer<M>, Failed> {
        match self {
            Self::Dds(node, _) => {
                let durability = if kind.is_latched { Durability::TransientLocal } else { Durability::Volatile };
                let quality = QosProfile::publisher_default()
                    .reliability_reliable(WhenFull::Fail)
                    .durability(durability)
                    .history(History::KeepLast { depth: kind.depth() });
                let name = MessageTypeName::new(kind.package, kind.name);
                let topic = node.create_topic(&Name::parse(topic)?, name, &quality)?;
                Ok(Writer::Dds(node.create_publisher(&topic, None)?))
            }
            #[cfg(feature = "zenoh")]
            Self::Zenoh(node) => Ok(Writer::Zenoh(node.writer(topic, kind)?)),
        }
    }

    /// Looks for changes of the network. Returns whether the node must be opened again.
    pub fn is_lost(&mut self) -> bool {
        match self {
            Self::Dds(_, known) => {
                let is_lost = addresses() != *known;
                if is_lost {
                    say("the addresses of this machine have changed: joining ROS 2 again");
                }
                is_lost
            }
            #[cfg(feature = "zenoh")]
            Self::Zenoh(node) => {
                node.watch();
                false
            }
        }
    }
}

/// The addresses of this machine that DDS uses. Those of IPv6 may change every day.
fn addresses() -> BTreeSet<Ipv4Addr> {
    let all = getifaddrs().into_iter().flatten().filter_map(|interface| interface.address);
    all.filter_map(|address| Some(address.as_sockaddr_in()?.ip())).collect()
}

/// A writer of one topic.
pub enum Writer<M: Serialize> {
    Dds(Publisher<M>),
    #[cfg(feature = "zenoh")]
    Zenoh(zenoh::Writer),
}

impl<M: Serialize> Writer<M> {
    /// Publishes a message. Returns how many messages were refused: 0 or 1.
    pub fn publish(&mut self, message: M) -> u64 {
        u64::from(match self {
            Self::Dds(writer) => writer.publish(message).is_err(),
            #[cfg(feature = "zenoh")]
            Self::Zenoh(writer) => writer.publish(&message).is_err(),
        })
    }
}
