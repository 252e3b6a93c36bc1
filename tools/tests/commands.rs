//! The program `facewire-tools`. This test also makes cargo build it for the tests of the workspace.

use std::process::Command;

#[test]
fn the_tools_are_those_in_the_help_of_the_service_print_their_own_and_refuse_a_command_of_the_service() {
    let commands = facewire_tools::command();
    let listed = facewire::cli::TOOLS.map(|(name, _)| name);
    assert!(commands.get_subcommands().map(clap::Command::get_name).eq(listed));
    let tools =
        |arguments: &[&str]| Command::new(env!("CARGO_BIN_EXE_facewire-tools")).args(arguments).output().unwrap();
    let help = String::from_utf8(tools(&["track", "--help"]).stdout).unwrap();
    assert!(help.contains("Usage: facewire track"), "{help}");
    assert!(help.contains("Exit status:"), "{help}");
    assert_eq!(tools(&["run"]).status.code(), Some(2));
}
