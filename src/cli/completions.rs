//! `wandless completions`: the completion script of a shell.

use clap::Command;
use clap_complete::{Shell, generate};

/// Prints the completion script of a shell, for example `wandless completions bash > ~/.local/share/bash-completion/completions/wandless`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Runs the command; `command`: the whole command line.
pub(super) fn run(args: &Args, command: &Command) {
    generate(args.shell, &mut without_hidden(command), "wandless", &mut std::io::stdout());
}

/// The command line without the child processes of the service, which the scripts of some shells would offer.
fn without_hidden(command: &Command) -> Command {
    let shown = command.get_subcommands().filter(|one| !one.is_hide_set()).cloned();
    Command::new("wandless").version(env!("CARGO_PKG_VERSION")).subcommands(shown)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn scripts_complete_commands_and_options() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let mut script = Vec::new();
            generate(shell, &mut without_hidden(&crate::cli::Cli::command()), "wandless", &mut script);
            let script = String::from_utf8(script).unwrap();
            assert!(!script.contains("run-job"), "{shell} offered a child process of the service");
            assert!(["reconstruct", "extrinsics", "refine"].iter().all(|word| script.contains(word)), "{shell}");
        }
    }
}
