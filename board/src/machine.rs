//! What the machine says of itself: which board it is, its processors and memory, and the flags of a Raspberry Pi's
//! firmware. Nothing here identifies the machine or its owner.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::{fmt, fs};

use rustix::param::page_size;
use rustix::system::uname;

use crate::sensors::text;
use crate::{Impairment, ImpairmentSet};

/// Entries of a device tree's `compatible` (of Linux and of the Raspberry Pi kernel), and the boards whose settings fit. A
/// device tree lists the board first and its system on a chip last, so boards with the same chip and no entry of their own
/// get the settings of the chip's board.
const DEVICE_TREES: [(&str, &[&str]); 6] = [
    ("pi-zero-2w", &["raspberrypi,model-zero-2-w", "raspberrypi,model-zero-2", "raspberrypi,0-compute-module"]),
    ("pi3", &["brcm,bcm2837"]),
    ("pi4", &["brcm,bcm2711"]),
    ("pi5", &["brcm,bcm2712"]),
    ("orange-pi-5", &["rockchip,rk3588", "rockchip,rk3588s"]),
    ("radxa-zero-3", &["rockchip,rk3566"]),
];
/// The names of Intel's processors that have only efficient cores begin with this and a number: N95, N97, N100, N150. The
/// names of older ones contain "Celeron" or "Pentium".
const INTEL_N: &str = "Intel(R) N";
/// What manufacturers leave in the firmware's tables instead of a name.
const PLACEHOLDERS: [&str; 6] =
    ["", "Default string", "To Be Filled By O.E.M.", "System Product Name", "System manufacturer", "Not Specified"];
/// ARM's numbers of cores, in `CPU part` of `/proc/cpuinfo` (Main ID registers of Arm's technical reference manuals).
const ARM_CORES: [(&str, &str); 7] = [
    ("0xd03", "Cortex-A53"),
    ("0xd04", "Cortex-A35"),
    ("0xd05", "Cortex-A55"),
    ("0xd08", "Cortex-A72"),
    ("0xd09", "Cortex-A73"),
    ("0xd0b", "Cortex-A76"),
    ("0xd41", "Cortex-A78"),
];

#[derive(Debug)]
pub struct Machine {
    /// The name of its settings, `generic` if it is not recognised.
    pub name: &'static str,
    /// What it calls itself. Contains no serial number.
    pub model: String,
    recognised_by: Option<String>,
}

impl Machine {
    /// Recognises the machine whose `/proc` and `/sys` lie below `root`.
    pub fn detect(root: &Path) -> Self {
        let cpus = fs::read_to_string(root.join("proc/cpuinfo")).unwrap_or_default();
        // Only PCs tell the name of the processor here.
        let name = cpus.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
        let processor = name.map(|(_, name)| name.trim());
        let compatible = text(&root.join("proc/device-tree/compatible")).unwrap_or_default();
        let by_tree = compatible.split('\0').find_map(|entry| {
            let (name, _) = DEVICE_TREES.into_iter().find(|(_, known)| known.contains(&entry))?;
            Some((name, format!("\"{entry}\" in the device tree")))
        });
        let is_number = |rest: &str| rest.starts_with(|c: char| c.is_ascii_digit());
        let is_intel_n = |name: &&str| name.strip_prefix(INTEL_N).is_some_and(is_number);
        let by_processor = || Some(("intel-n100", format!("the processor {}", processor.filter(is_intel_n)?)));
        let (name, recognised_by) = by_tree.or_else(by_processor).unzip();
        Self { name: name.unwrap_or("generic"), model: model(root, processor), recognised_by }
    }

    /// Says which board's settings are in force, and why.
    pub fn tell(&self, in_force: &str) -> String {
        let Self { name, model, recognised_by } = self;
        match recognised_by {
            _ if in_force != *name => format!("{in_force}, because the settings say so; this is {name} ({model})"),
            Some(by) => format!("{name}, recognised by {by} ({model})"),
            None => format!("{name}, because this machine is not one of those with settings of their own ({model})"),
        }
    }
}

/// Returns what the device tree, or else the firmware and the processor, call this machine.
fn model(root: &Path, processor: Option<&str>) -> String {
    if let Some(model) = text(&root.join("proc/device-tree/model")) {
        return model;
    }
    let of_firmware = |file| text(&root.join("sys/class/dmi/id").join(file));
    let named = ["sys_vendor", "product_name"].into_iter().filter_map(of_firmware);
    let named: Vec<_> = named.filter(|name| !PLACEHOLDERS.contains(&name.as_str())).collect();
    let parts = [named.join(" "), processor.unwrap_or_default().to_owned()];
    let known: Vec<_> = parts.into_iter().filter(|part| !part.is_empty()).collect();
    if known.is_empty() { "without a name".to_owned() } else { known.join(", ") }
}

/// Returns the kernel's release and architecture, the size of its pages, and the architecture of this program, which
/// may be 32-bit on a 64-bit kernel.
pub fn system() -> String {
    let names = uname();
    let (release, machine) = (names.release().to_string_lossy(), names.machine().to_string_lossy());
    let program = std::env::consts::ARCH;
    format!("Linux {release} for {machine}, pages of {} bytes; program for {program}", page_size())
}

pub fn processors(root: &Path) -> String {
    let cpus = fs::read_to_string(root.join("proc/cpuinfo")).unwrap_or_default();
    let kind = |line: &str| {
        let (key, value) = line.split_once(':')?;
        let value = value.trim();
        match key.trim() {
            "model name" if !cpus.contains("CPU part") => Some(value.to_owned()),
            "CPU part" => {
                let known = ARM_CORES.into_iter().find(|(number, _)| *number == value);
                Some(known.map_or_else(|| format!("ARM part {value}"), |(_, name)| name.to_owned()))
            }
            _ => None,
        }
    };
    let mut counts = BTreeMap::new();
    cpus.lines().filter_map(kind).for_each(|kind| *counts.entry(kind).or_insert(0) += 1);
    let counts: Vec<_> = counts.iter().map(|(kind, count)| format!("{count} x {kind}")).collect();
    if counts.is_empty() { "unknown".to_owned() } else { counts.join(", ") }
}

/// Returns the memory that the kernel manages, MiB.
pub fn memory_mb(root: &Path) -> Option<u64> {
    let memory = fs::read_to_string(root.join("proc/meminfo")).ok()?;
    let total = memory.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    total.split_whitespace().next()?.parse::<u64>().ok().map(|kb| kb / 1024)
}

/// A Raspberry Pi's flags of low voltage and reduced clock rate, as the program `vcgencmd` prints them. Only commands that
/// a person runs ask for them: the service starts no programs. The flags also tell what happened since the board's start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flags(u32);

/// What the bits from 0 on mean, for now, and the bits from 16 on, for any time since the start.
const MEANINGS: [&str; 4] = ["low voltage", "clock rate capped", "throttled", "soft temperature limit"];
const LOW_VOLTAGE: u32 = 1 << 16 | 1;
const SLOWED_DOWN: u32 = 0b110 << 16 | 0b110;
const SOFT_LIMIT: u32 = 1 << 19 | 1 << 3;

impl Flags {
    /// Asks the firmware. Returns `None` where there is no `vcgencmd`, or where it may not ask.
    pub fn ask() -> Option<Self> {
        let output = Command::new("vcgencmd").arg("get_throttled").stdin(Stdio::null()).output().ok()?;
        Self::parse(std::str::from_utf8(&output.stdout).ok()?)
    }

    fn parse(text: &str) -> Option<Self> {
        u32::from_str_radix(text.trim().strip_prefix("throttled=0x")?, 16).ok().map(Self)
    }

    /// What has impaired the board since its start. Low voltage reduces the clock rate, too, so a reduced clock rate means
    /// heat only where the voltage was never low.
    pub fn impairments(self) -> ImpairmentSet {
        let has = |bits| self.0 & bits != 0;
        let mut found = ImpairmentSet::default();
        found.set(Impairment::Undervoltage, has(LOW_VOLTAGE));
        found.set(Impairment::Hot, has(SOFT_LIMIT) || has(SLOWED_DOWN) && !has(LOW_VOLTAGE));
        found
    }
}

impl fmt::Display for Flags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = |first: usize| {
            let set = MEANINGS.iter().enumerate().filter(|(bit, _)| self.0 >> (first + bit) & 1 == 1);
            let names: Vec<_> = set.map(|(_, name)| *name).collect();
            if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
        };
        write!(f, "firmware flags 0x{:x}: {} now, {} since the start", self.0, named(0), named(16))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::tests::Tree;

    #[test]
    fn boards_are_recognised_by_their_device_tree_and_intels_n_series_by_its_processor() {
        let cases = [
            ("raspberrypi,3-model-b-plus brcm,bcm2837", "", "pi3"),
            ("raspberrypi,model-zero-2-w brcm,bcm2837", "", "pi-zero-2w"),
            ("xunlong,orangepi-5 rockchip,rk3588s", "", "orange-pi-5"),
            ("raspberrypi,model-zero-w brcm,bcm2835", "", "generic"),
            ("", "Intel(R) N95", "intel-n100"),
            ("", "Intel(R) Core(TM) i3-N305", "generic"),
            ("", "Intel(R) NUC", "generic"),
        ];
        for (compatible, processor, name) in cases {
            let compatible = compatible.replace(' ', "\0") + "\0";
            let cpus = format!("processor\t: 0\nmodel name\t: {processor}\ncpu MHz\t\t: 800\n");
            let files = [
                ("proc/device-tree/compatible", compatible.as_str()),
                ("proc/cpuinfo", cpus.as_str()),
                ("sys/class/dmi/id/product_name", "Default string\n"),
            ];
            let machine = Machine::detect(Tree::new(&files).root());
            let model = if processor.is_empty() { "without a name" } else { processor };
            assert_eq!((machine.name, machine.model.as_str()), (name, model), "{compatible}");
        }
        let recognised = DEVICE_TREES.iter().map(|(name, _)| format!("{name}.toml"));
        let recognised = recognised.chain(["generic.toml", "intel-n100.toml"].map(str::to_owned));
        let files = fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../boards")).unwrap();
        let with_settings = files.map(|file| file.unwrap().file_name().into_string().unwrap());
        assert_eq!(recognised.collect::<BTreeSet<_>>(), with_settings.collect(), "boards with settings");
    }

    #[test]
    fn processors_are_counted_by_kind_and_serial_numbers_are_left_out() {
        let with_cpus = |cpus: &str| processors(Tree::new(&[("proc/cpuinfo", cpus)]).root());
        let cpu = |part: &str| format!("processor\t: 0\nmodel name\t: ARMv7 rev 4\nCPU part\t: {part}\n\n");
        let rk3588 = (cpu("0xd05") + &cpu("0xd0b")).repeat(4) + "Serial\t\t: 58f3a7c2b1d0e946\n";
        assert_eq!(with_cpus(&rk3588), "4 x Cortex-A55, 4 x Cortex-A76");
        assert_eq!(with_cpus(&"model name\t: Intel(R) N100\n".repeat(4)), "4 x Intel(R) N100");
        assert_eq!([with_cpus("CPU part\t: 0xd99\n"), with_cpus("")], ["1 x ARM part 0xd99", "unknown"]);
    }

    #[test]
    fn the_flags_of_a_raspberry_pi_tell_low_voltage_from_heat() {
        let cases = [
            ("throttled=0x0\n", "none"),
            ("throttled=0x50000\n", "undervoltage"),
            ("throttled=0x20002", "hot"),
            ("throttled=0x80008", "hot"),
            ("throttled=0xd0008", "undervoltage,hot"),
        ];
        for (text, want) in cases {
            assert_eq!(Flags::parse(text).unwrap().impairments().to_string(), want, "{text}");
        }
        assert!(["", "VCHI initialization failed\n", "throttled=x"].iter().all(|no| Flags::parse(no).is_none()));
    }
}
