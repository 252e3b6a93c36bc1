//! Recognises the board by its device tree or its processor.

use std::fs;
use std::path::Path;

use super::files::text;

/// Entries of a device tree's `compatible`, and the boards whose settings fit. A device tree lists the board first and its
/// system on a chip last, so boards with the same chip and no entry of their own get the settings of the chip's board.
/// From the device trees of Linux and of the Raspberry Pi kernel.
const DEVICE_TREES: [(&str, &str); 9] = [
    ("raspberrypi,model-zero-2-w", "pi-zero-2w"),
    ("raspberrypi,model-zero-2", "pi-zero-2w"),
    ("raspberrypi,0-compute-module", "pi-zero-2w"),
    ("brcm,bcm2837", "pi3"),
    ("brcm,bcm2711", "pi4"),
    ("brcm,bcm2712", "pi5"),
    ("rockchip,rk3588", "orange-pi-5"),
    ("rockchip,rk3588s", "orange-pi-5"),
    ("rockchip,rk3566", "radxa-zero-3"),
];
/// How the names of Intel's processors with nothing but efficient cores begin, before a number: N95, N97, N100, N150. The
/// names of older ones contain "Celeron" or "Pentium".
const INTEL_N: &str = "Intel(R) N";
/// What makers leave in the firmware's tables.
const PLACEHOLDERS: [&str; 6] =
    ["", "Default string", "To Be Filled By O.E.M.", "System Product Name", "System manufacturer", "Not Specified"];

/// The board that facewire runs on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Board {
    /// The name of its settings, `generic` if it is not recognised.
    pub name: &'static str,
    /// What it calls itself. Contains no serial number.
    pub model: String,
    /// What it was recognised by.
    by: Option<String>,
}

impl Board {
    /// Recognises the board whose `/proc` and `/sys` lie below `root`.
    #[must_use]
    pub fn detect(root: &Path) -> Self {
        let processor = processor(root);
        let by_tree = compatible(root).into_iter().find_map(|entry| {
            let (_, name) = DEVICE_TREES.into_iter().find(|(known, _)| *known == entry)?;
            Some((name, format!("\"{entry}\" in the device tree")))
        });
        let is_intel_n = |name: &&String| {
            name.strip_prefix(INTEL_N).is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit()))
        };
        let by_processor = || Some(("intel-n100", format!("the processor {}", processor.as_ref().filter(is_intel_n)?)));
        let (name, by) = by_tree.or_else(by_processor).unzip();
        Self { name: name.unwrap_or("generic"), model: model(root, processor.as_deref()), by }
    }

    /// Tells which settings are in force, and why.
    #[must_use]
    pub fn tell(&self, in_force: &str) -> String {
        let Self { name, model, by } = self;
        match by {
            _ if in_force != *name => format!("{in_force}, because the settings say so; this is {name} ({model})"),
            Some(by) => format!("{name}, recognised by {by} ({model})"),
            None => format!("{name}, because this machine is not one of those with settings of their own ({model})"),
        }
    }
}

/// Returns the entries of the device tree's `compatible`, the most specific one first.
fn compatible(root: &Path) -> Vec<String> {
    let entries = text(&root.join("proc/device-tree/compatible")).unwrap_or_default();
    entries.split('\0').map(str::to_owned).collect()
}

/// Returns the name of the processor, which only PCs tell.
fn processor(root: &Path) -> Option<String> {
    let cpus = fs::read_to_string(root.join("proc/cpuinfo")).ok()?;
    let line = cpus.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(": ")?.1.trim().to_owned())
}

/// Returns what the device tree, or else the firmware and the processor, call this machine.
fn model(root: &Path, processor: Option<&str>) -> String {
    if let Some(model) = text(&root.join("proc/device-tree/model")) {
        return model;
    }
    let of_firmware = |file| text(&root.join("sys/class/dmi/id").join(file));
    let known = |name: &String| !PLACEHOLDERS.contains(&name.as_str());
    let named = ["sys_vendor", "product_name"].into_iter().filter_map(of_firmware).filter(known);
    let named = named.collect::<Vec<_>>().join(" ");
    match processor {
        Some(processor) if named.is_empty() => processor.to_owned(),
        Some(processor) => format!("{named}, {processor}"),
        None if named.is_empty() => "without a name".to_owned(),
        None => named,
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Tree;
    use super::*;
    use crate::config::BOARDS;

    fn with_tree(compatible: &str) -> Board {
        let compatible = compatible.replace(' ', "\0") + "\0";
        let files =
            [("proc/device-tree/compatible", compatible.as_str()), ("proc/device-tree/model", "A Board Rev 1.2\0")];
        Board::detect(Tree::new(&files).root())
    }

    fn with_processor(name: &str) -> Board {
        let cpus = format!("processor\t: 0\nvendor_id\t: GenuineIntel\nmodel name\t: {name}\ncpu MHz\t\t: 800.000\n");
        let files = [("proc/cpuinfo", cpus.as_str()), ("sys/class/dmi/id/product_name", "Default string\n")];
        Board::detect(Tree::new(&files).root())
    }

    #[test]
    fn boards_are_recognised_by_the_device_trees_of_mainline_and_of_their_makers() {
        let cases = [
            ("raspberrypi,3-model-b brcm,bcm2837", "pi3"),
            ("raspberrypi,3-model-b-plus brcm,bcm2837", "pi3"),
            ("raspberrypi,3-model-a-plus brcm,bcm2837", "pi3"),
            ("raspberrypi,3-compute-module brcm,bcm2837", "pi3"),
            ("raspberrypi,model-zero-2-w brcm,bcm2837", "pi-zero-2w"),
            ("raspberrypi,0-compute-module brcm,bcm2837", "pi-zero-2w"),
            ("raspberrypi,4-model-b brcm,bcm2711", "pi4"),
            ("raspberrypi,400 brcm,bcm2711", "pi4"),
            ("raspberrypi,4-compute-module brcm,bcm2711", "pi4"),
            ("raspberrypi,5-model-b brcm,bcm2712", "pi5"),
            ("raspberrypi,500 brcm,bcm2712", "pi5"),
            ("raspberrypi,5-compute-module brcm,bcm2712", "pi5"),
            ("xunlong,orangepi-5 rockchip,rk3588s", "orange-pi-5"),
            ("xunlong,orangepi-5b rockchip,rk3588s", "orange-pi-5"),
            ("xunlong,orangepi-5-plus rockchip,rk3588", "orange-pi-5"),
            ("rockchip,rk3588s-orangepi-5 rockchip,rk3588", "orange-pi-5"),
            ("rockchip,rk3588-orangepi-5-plus rockchip,rk3588", "orange-pi-5"),
            ("radxa,rock-5b rockchip,rk3588", "orange-pi-5"),
            ("radxa,zero-3w rockchip,rk3566", "radxa-zero-3"),
            ("radxa,zero-3e rockchip,rk3566", "radxa-zero-3"),
            ("radxa,zero3 rockchip,rk3566", "radxa-zero-3"),
            ("raspberrypi,model-zero-w brcm,bcm2835", "generic"),
            ("linux,dummy-virt", "generic"),
        ];
        for (compatible, name) in cases {
            assert_eq!(with_tree(compatible).name, name, "{compatible}");
        }
    }

    #[test]
    fn intels_n_series_is_recognised_by_the_processor_because_its_boards_have_no_names() {
        let of = |name| with_processor(name).name;
        assert_eq!(["Intel(R) N100", "Intel(R) N95", "Intel(R) N97", "Intel(R) N150"].map(of), ["intel-n100"; 4]);
        let others = ["Intel(R) Celeron(R) N5105 @ 2.00GHz", "Intel(R) Core(TM) i3-N305", "AMD EPYC", "Intel(R) NUC"];
        assert_eq!(others.map(of), ["generic"; 4]);
        assert_eq!(with_processor("Intel(R) N100").model, "Intel(R) N100");
    }

    #[test]
    fn every_board_that_is_recognised_has_settings_and_every_other_one_is_recognised() {
        let recognised = DEVICE_TREES.map(|(_, name)| name).into_iter().chain(["generic", "intel-n100"]);
        let mut recognised: Vec<_> = recognised.collect();
        recognised.sort_unstable();
        recognised.dedup();
        let mut with_settings = BOARDS.map(|(name, _)| name);
        with_settings.sort_unstable();
        assert_eq!(recognised, with_settings);
    }

    #[test]
    fn the_board_tells_what_it_was_recognised_by_and_when_the_settings_name_another_one() {
        let board = with_tree("raspberrypi,4-model-b brcm,bcm2711");
        let want = "pi4, recognised by \"brcm,bcm2711\" in the device tree (A Board Rev 1.2)";
        assert_eq!(board.tell("pi4"), want);
        assert_eq!(board.tell("pi5"), "pi5, because the settings say so; this is pi4 (A Board Rev 1.2)");
        let nameless = Board::detect(Tree::new(&[]).root());
        assert!(nameless.tell("generic").ends_with(" (without a name)"));
    }
}
