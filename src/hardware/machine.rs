//! What a report says of the machine: kernel, processors and memory, and nothing that identifies it or its owner.

use std::fs;
use std::path::Path;

use rustix::param::page_size;
use rustix::system::uname;

/// ARM's numbers of cores, in `CPU part` of `/proc/cpuinfo` (Main ID registers of Arm's technical reference manuals).
const ARM_CORES: [(&str, &str); 11] = [
    ("0xc07", "Cortex-A7"),
    ("0xc0f", "Cortex-A15"),
    ("0xd03", "Cortex-A53"),
    ("0xd04", "Cortex-A35"),
    ("0xd05", "Cortex-A55"),
    ("0xd07", "Cortex-A57"),
    ("0xd08", "Cortex-A72"),
    ("0xd09", "Cortex-A73"),
    ("0xd0a", "Cortex-A75"),
    ("0xd0b", "Cortex-A76"),
    ("0xd41", "Cortex-A78"),
];

/// Returns the kernel's release and architecture, the size of its pages, and the architecture of this program, which
/// may be 32-bit on a 64-bit kernel.
#[must_use]
pub fn system() -> String {
    let names = uname();
    let (release, machine) = (names.release().to_string_lossy(), names.machine().to_string_lossy());
    let program = std::env::consts::ARCH;
    format!("Linux {release} for {machine}, pages of {} bytes; program for {program}", page_size())
}

/// Returns how many processors of each kind there are.
#[must_use]
pub fn processors(root: &Path) -> String {
    let cpus = fs::read_to_string(root.join("proc/cpuinfo")).unwrap_or_default();
    let kinds = cpus.lines().filter_map(|line| {
        let (key, value) = line.split_once(':')?;
        match key.trim() {
            "model name" if !cpus.contains("CPU part") => Some(value.trim().to_owned()),
            "CPU part" => Some(arm_core(value.trim())),
            _ => None,
        }
    });
    let mut counts: Vec<(String, usize)> = Vec::new();
    for kind in kinds {
        match counts.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, count)) => *count += 1,
            None => counts.push((kind, 1)),
        }
    }
    let counts: Vec<_> = counts.into_iter().map(|(kind, count)| format!("{count} x {kind}")).collect();
    if counts.is_empty() { "unknown".to_owned() } else { counts.join(", ") }
}

fn arm_core(part: &str) -> String {
    let known = ARM_CORES.into_iter().find(|(number, _)| *number == part);
    known.map_or_else(|| format!("ARM part {part}"), |(_, name)| name.to_owned())
}

/// Returns the memory that the kernel uses.
#[must_use]
pub fn memory_mb(root: &Path) -> Option<u64> {
    let memory = fs::read_to_string(root.join("proc/meminfo")).ok()?;
    let total = memory.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    total.split_whitespace().next()?.parse::<u64>().ok().map(|kb| kb / 1024)
}

#[cfg(test)]
mod tests {
    use super::super::tests::Tree;
    use super::*;

    fn with_cpus(cpus: &str) -> String {
        processors(Tree::new(&[("proc/cpuinfo", cpus)]).root())
    }

    #[test]
    fn processors_are_counted_by_kind_and_serial_numbers_are_left_out() {
        let of_64_bits = |part: &str| format!("processor\t: 0\nCPU implementer\t: 0x41\nCPU part\t: {part}\n\n");
        let rk3588 = of_64_bits("0xd05").repeat(4) + &of_64_bits("0xd0b").repeat(4) + "Serial\t\t: 58f3a7c2b1d0e946\n";
        assert_eq!(with_cpus(&rk3588), "4 x Cortex-A55, 4 x Cortex-A76");
        let of_32_bits = "processor\t: 0\nmodel name\t: ARMv7 Processor rev 4 (v7l)\nCPU part\t: 0xd03\n\n";
        let pi = of_32_bits.repeat(4) + "Hardware\t: BCM2835\nRevision\t: a02082\nSerial\t\t: 00000000d5c3b2a1\n";
        assert_eq!(with_cpus(&pi), "4 x Cortex-A53");
        assert_eq!(with_cpus(&"model name\t: Intel(R) N100\n".repeat(4)), "4 x Intel(R) N100");
        assert_eq!(with_cpus("CPU part\t: 0xd99\n"), "1 x ARM part 0xd99");
        assert_eq!(with_cpus(""), "unknown");
    }

    #[test]
    fn memory_is_the_total_of_the_kernel() {
        let tree = Tree::new(&[("proc/meminfo", "MemTotal:         426508 kB\nMemFree:          1234 kB\n")]);
        assert_eq!((memory_mb(tree.root()), memory_mb(Tree::new(&[]).root())), (Some(416), None));
    }
}
