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
pub(super) fn run(args: &Args, mut command: Command) {
    generate(args.shell, &mut command, "wandless", &mut std::io::stdout());
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn scripts_complete_commands_and_options() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let mut script = Vec::new();
            generate(shell, &mut crate::cli::Cli::command(), "wandless", &mut script);
            let script = String::from_utf8(script).unwrap();
            assert!(["reconstruct", "extrinsics", "refine"].iter().all(|word| script.contains(word)), "{shell}");
        }
    }
}
