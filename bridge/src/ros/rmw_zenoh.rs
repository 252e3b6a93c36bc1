//! The formats of `rmw_zenoh_cpp`, by which nodes of ROS 2 speak over Zenoh: keys, liveliness tokens, attachments, payloads.
//!
//! They are those of `docs/design.md`, `liveliness_utils.cpp` and `attachment_helpers.cpp` in ros2/rmw_zenoh, which hold for
//! Jazzy (rmw_zenoh 0.2.5 and later), Kilted, Lyrical and Rolling. Earlier versions name the fields of attachments, and
//! Humble has no hashes of types.

use byteorder::LittleEndian;
use serde::Serialize;
use twox_hash::XxHash3_128;

use super::{Kind, NODE};

/// A type by the name that it has in DDS, and the hash of its definition.
fn type_and_hash(Kind { package, name, hash, .. }: &Kind) -> String {
    format!("{package}::msg::dds_::{name}_/{hash}")
}

/// The key to which messages go. The topic begins with a slash.
pub fn key(domain: u16, topic: &str, kind: &Kind) -> String {
    format!("{domain}{topic}/{}", type_and_hash(kind))
}

/// The token that announces the node, which is number 0 of its session. A lone percent sign is an empty name.
pub fn node_token(domain: u16, session: &str) -> String {
    format!("@ros2_lv/{domain}/{session}/0/0/NN/%/%/{NODE}")
}

/// The token that announces a writer, with a number of its own. Of the quality of service, it lists only what differs from
/// the default: the fields for reliable, for volatile and for keeping the last messages are empty.
pub fn writer_token(domain: u16, session: &str, number: u64, topic: &str, kind: &Kind) -> String {
    let (topic, durability) = (topic.replace('/', "%"), if kind.is_latched { "1" } else { "" });
    let (types, depth) = (type_and_hash(kind), kind.depth());
    format!("@ros2_lv/{domain}/{session}/0/{number}/MP/%/%/{NODE}/{topic}/{types}/:{durability}:,{depth}:,:,:,,")
}

/// The identifier of a writer.
pub fn gid(token: &str) -> [u8; 16] {
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

/// The attachment of a message: its number from 1, the time, and the length and bytes of its writer's identifier.
pub fn attachment(number: i64, since_1970_ns: i64, gid: [u8; 16]) -> Vec<u8> {
    [&number.to_le_bytes()[..], &since_1970_ns.to_le_bytes(), &[16], &gid].concat()
}

/// A message as CDR, with the header that says so.
pub fn payload(message: &impl Serialize) -> cdr_encoding::Result<Vec<u8>> {
    let mut bytes = vec![0, 1, 0, 0];
    // The encoder counts alignment from the first byte that it writes, which is the one after the header.
    cdr_encoding::to_writer::<_, LittleEndian, _>(&mut bytes, message)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::{
        super::{
            BOOL, POSE_STAMPED,
            messages::{Header, IdsList, JointState, Pose, PoseStamped},
        },
        *,
    };

    const SESSION: &str = "8b20917502ee955ac4476e0266340d5c";

    /// The examples of docs/design.md, with names and depths of this program.
    #[test]
    fn keys_and_tokens_are_those_of_rmw_zenohs_design() {
        let hash = "RIHS01_feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9";
        let want = format!("2/facewire/left/face/std_msgs::msg::dds_::Bool_/{hash}");
        assert_eq!(key(2, "/facewire/left/face", &BOOL), want);
        assert_eq!(node_token(2, SESSION), format!("@ros2_lv/2/{SESSION}/0/0/NN/%/%/facewire_bridge"));
        let writer = format!("@ros2_lv/2/{SESSION}/0/10/MP/%/%/facewire_bridge/%facewire%left%");
        let want = format!("{writer}face/std_msgs::msg::dds_::Bool_/{hash}/:1:,1:,:,:,,");
        assert_eq!(writer_token(2, SESSION, 10, "/facewire/left/face", &BOOL), want);
        let hash = "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8";
        let want = format!("{writer}head_pose/geometry_msgs::msg::dds_::PoseStamped_/{hash}/::,5:,:,:,,");
        assert_eq!(writer_token(2, SESSION, 10, "/facewire/left/head_pose", &POSE_STAMPED), want);
    }

    /// The identifier is that of the Python package xxhash for the token of a node in docs/design.md.
    #[test]
    fn attachments_have_the_number_the_time_and_the_hash_of_the_writers_token() {
        let gid = gid("@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener");
        assert_eq!(gid, 0x5bd7_2f4d_af53_c0bb_00c7_394e_7fc1_9547_u128.to_be_bytes());
        let bytes = attachment(7, 0x0102_0304_0506_0708, [0xab; 16]);
        assert_eq!(bytes[..17], [7, 0, 0, 0, 0, 0, 0, 0, 8, 7, 6, 5, 4, 3, 2, 1, 16]);
        assert_eq!(bytes[17..], [0xab; 16]);
    }

    /// The bytes are those of the Python package rosbags.
    #[test]
    fn payloads_are_cdr_with_its_header() {
        let stamp = (std::time::UNIX_EPOCH + std::time::Duration::new(1, 2)).into();
        let header = Header { stamp, frame_id: "cam".to_owned() };
        let hex = |bytes: Vec<u8>| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        let start = "00010000010000000200000004000000";
        let pose = Pose { position: [0.0, 0.0, 0.5], orientation: [0.0, 0.0, 0.0, 1.0] };
        let [zeros_16, zeros_24] = [16, 24].map(|bytes| "00".repeat(bytes));
        let want = format!("{start}63616d00{zeros_16}000000000000e03f{zeros_24}000000000000f03f");
        assert_eq!(hex(payload(&PoseStamped { header: header.clone(), pose }).unwrap()), want);
        let position = vec![0.25];
        let joints = JointState { header: header.clone(), name: &["jaw"], position, velocity: &[], effort: &[] };
        let want = format!("{start}63616d0001000000040000006a61770001000000000000000000d03f0000000000000000");
        assert_eq!(hex(payload(&joints).unwrap()), want);
        let ids = IdsList { header, ids: vec!["a1b2c".to_owned()] };
        assert_eq!(hex(payload(&ids).unwrap()), format!("{start}63616d000100000006000000613162326300"));
    }
}
