//! Settings of links to head-mounted displays and avatars.

mod values;

use std::fmt;

use toml::de::DeValue;

use super::{
    section::{Section, section, write_setting},
    value::{Address, Value},
};

use self::values::MOST_BITS;
pub use self::values::{JsonTarget, ListenAddress, MaybeAddress, OscPrefix, ParameterChoice, Parameters, Text};

section! {
    /// Live Link Face.
    LiveLinkSettings {
        /// The machine that runs Unreal, and the port of its plugin.
        address: Address = Address::local(11_111), (), "";
        /// The name of the subject in Unreal. Give each face a name of its own.
        subject: Text = Text::from("facewire"), 1..=64, "";
        /// The name of the device. Some receivers read exactly 36 characters.
        device_id: Text = Text::from("facewire-0000-0000-0000-000000000000"), 36..=36, "";
        /// Exchanges `mouthLeft` and `mouthRight`, as the app Live Link Face does by mistake. Some receivers expect
        /// this mistake and exchange them back.
        swap_mouth: bool = false, (), "";
    }
}

section! {
    /// VMC.
    VmcSettings {
        /// The machine that runs the application, and its port: 39540 for VSeeFace and others that add a face to a body
        /// of their own; 39539 for Warudo, EVMC4U and others that can take a whole body.
        address: Address = Address::local(39_540), (), "";
        /// Whether the rotations of the head and the eyes are sent, too. If not, only blendshapes are sent.
        bones: bool = true, (), "";
        /// Whether messages travel together in bundles. A few receivers do not read bundles; they get a datagram for each
        /// message.
        bundles: bool = true, (), "";
    }
}

section! {
    /// VRChat and VRCFaceTracking.
    VrchatSettings {
        /// The machine that runs VRChat, and its port for incoming OSC.
        address: Address = Address::local(9000), (), "";
        /// What the avatar puts before `v2/` in the names of its parameters, such as "FT/".
        prefix: OscPrefix = OscPrefix::default(), (), "";
        /// Whether parameters are sent as one number each.
        floats: bool = true, (), "";
        /// Number of bits of binary parameters, which avatars use to save memory: 0 for none.
        bits: u32 = 0, 0..=MOST_BITS, "";
        /// Whether to send parameters of single movements, such as `v2/JawOpen`.
        shapes: bool = true, (), "";
        /// Whether to send parameters that stand for several movements, such as `v2/SmileFrown`.
        compounds: bool = true, (), "";
        /// Whether to send the turn of the head as `v2/Head/Yaw`, `v2/Head/Pitch` and `v2/Head/Roll`.
        head: bool = true, (), "";
        /// Whether to send the eyes to VRChat's own addresses (`/tracking/eye/`), too. Avatars without parameters for
        /// eyes need this.
        native_eyes: bool = false, (), "";
        /// The parameters to send, if not all: their names after `v2/`, each with the number of its bits if it is binary,
        /// such as "JawOpen, SmileFrown:4". `floats`, `bits`, `shapes`, `compounds` and `head` then have no effect.
        parameters: Parameters = Parameters::default(), (), "";
    }
}

section! {
    /// iFacialMocap.
    IFacialMocapSettings {
        /// Where receivers ask for the face, as they ask the iPhone: an address of this machine in numbers and a port, or ""
        /// not to listen.
        listen: ListenAddress = ListenAddress::any(49_983), (), "";
        /// The port at which receivers that asked get the face; 0 for the port that they asked from.
        reply_port: u32 = 49_983, 0..=65_535, "";
        /// A receiver that gets the face without asking, or "".
        address: MaybeAddress = MaybeAddress::default(), (), "";
        /// The version of the protocol for `address`. Receivers that ask choose the version themselves.
        version: u32 = 2, 1..=2, "";
    }
}

/// Shows where receivers ask, and who gets the face without asking.
impl fmt::Display for IFacialMocapSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.listen.0, &self.address.0) {
            (Some(listen), Some(address)) => write!(f, "those who ask at {listen}, and {address}"),
            (Some(listen), None) => write!(f, "those who ask at {listen}"),
            (None, Some(address)) => address.fmt(f),
            (None, None) => f.write_str("nobody"),
        }
    }
}

section! {
    /// JSON lines.
    JsonSettings {
        /// Where the lines go:
        /// - "stdout": standard output. The log goes to standard error
        /// - "udp:HOST:PORT": one datagram for each line
        /// - "unix:PATH": a Unix socket at which up to 8 programs read
        to: JsonTarget = JsonTarget::Stdout, (), "";
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use crate::config::{defaults, parse, written};

    fn fault(keys: &str) -> String {
        parse("file", &format!("[[link]]\n{keys}\n")).unwrap_err().to_string()
    }

    #[test]
    fn settings_of_receivers_load_back_from_their_written_form() {
        for keys in [
            "kind = \"live-link\"\nsubject = \"my face\"\ndevice_id = \"0123456789abcdef0123456789abcdef0123\"\n",
            "kind = \"vmc\"\nbones = false\n",
            "kind = \"ifacialmocap\"\nlisten = \"[::1]:49983\"\nreply_port = 0\naddress = \"pc.local:49983\"\nversion = 1\n",
            "kind = \"json\"\nto = \"udp:pc.local:5000\"\n",
            "kind = \"json\"\nto = \"unix:/run/facewire/lines\"\n",
            "kind = \"vrchat\"\nprefix = \"FT/\"\nbits = 4\nparameters = \"JawOpen, EyeLidLeft:3\"\n",
        ] {
            let settings = parse("file", &format!("[[link]]\n{keys}")).unwrap();
            assert_eq!(parse("written", &written(&settings)).unwrap(), settings);
        }
        assert!(defaults().contains(" - \"live-link\": Live Link Face for Unreal"));
    }

    #[test]
    fn values_that_receivers_would_not_understand_are_refused() {
        assert!(
            fault("kind = \"live-link\"\nsubject = \"\"")
                .ends_with("give 1 to 64 printable ASCII characters in quotes")
        );
        assert!(
            fault("kind = \"live-link\"\ndevice_id = \"short\"")
                .ends_with("give 36 printable ASCII characters in quotes")
        );
        for to in ["file", "unix:lines", "udp:5000"] {
            assert!(fault(&format!("kind = \"json\"\nto = \"{to}\"")).contains("give \"stdout\""), "{to}");
        }
        for listen in ["localhost:49983", "0.0.0.0:0", "49983"] {
            let fault = fault(&format!("kind = \"ifacialmocap\"\nlisten = \"{listen}\""));
            assert!(fault.contains("an address of this machine in numbers"), "{fault}");
        }
        for prefix in ["FT", "/FT/", "F T/", "FT*/"] {
            assert!(
                fault(&format!("kind = \"vrchat\"\nprefix = \"{prefix}\"")).contains("end with a slash"),
                "{prefix}"
            );
        }
        for parameters in ["JawOpn", "JawOpen:9", "JawOpen SmileFrown"] {
            let fault = fault(&format!("kind = \"vrchat\"\nparameters = \"{parameters}\""));
            assert!(fault.contains("names of parameters of VRCFaceTracking v2"), "{fault}");
        }
    }
}
