//! Writes the manual pages and shell completions of the programs into a folder, from the definitions of their arguments.

#[path = "../../bridge/src/args.rs"]
mod bridge;
#[path = "../../console/src/args.rs"]
mod view;

use std::path::{Path, PathBuf};
use std::{env, fs, io};

use clap::{Command, CommandFactory as _};
use clap_complete::{Shell, generate_to};
use clap_mangen::Man;

fn main() -> io::Result<()> {
    let usage = || io::Error::new(io::ErrorKind::InvalidInput, "usage: manual FOLDER");
    let folder = PathBuf::from(env::args_os().nth(1).ok_or_else(usage)?);
    fs::create_dir_all(&folder)?;
    for command in [whole_command(), view::Args::command(), bridge::Args::command()] {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            generate_to(shell, &mut command.clone(), command.get_name(), &folder)?;
        }
        let mut command = command.disable_help_subcommand(true);
        command.build();
        command.get_subcommands().try_for_each(|subcommand| write_page(subcommand, &folder))?;
        write_page(&command, &folder)?;
    }
    // The program of the commands that are described there.
    fs::write(folder.join("facewire-tools.1"), ".so man1/facewire.1\n")
}

/// The command `facewire` as a user sees it: with the commands of `facewire-tools` in full.
fn whole_command() -> Command {
    let tools = facewire_tools::command();
    tools
        .get_subcommands()
        .fold(facewire::cli::command(), |whole, tool| whole.mut_subcommand(tool.get_name(), |_| tool.clone()))
}

/// Writes the page of a command.
fn write_page(command: &Command, folder: &Path) -> io::Result<()> {
    let name = command.get_display_name().unwrap_or(command.get_name());
    let page = Man::new(command.clone()).manual("facewire").source(concat!("facewire ", env!("CARGO_PKG_VERSION")));
    let mut text = Vec::new();
    page.render(&mut text)?;
    // The lines of examples and exit statuses are not to be filled.
    let text = String::from_utf8_lossy(&text).replace(".SH EXTRA\n", ".SH EXAMPLES AND EXIT STATUS\n.nf\n");
    fs::write(folder.join(format!("{name}.1")), text)
}
