//! `wandless options`: lists every option of a job.

use crate::pipeline::option_reference::{options_document, options_list, options_page};

/// Lists every option of a job with type, default, range and effect.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Print the page docs/options.md
    #[arg(long, conflicts_with = "json")]
    markdown: bool,
    /// Print the table as JSON, as the viewer reads it
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn run(args: &Args) {
    if args.markdown {
        print!("{}", options_page());
    } else if args.json {
        println!("{:#}", options_document());
    } else {
        print!("{}", options_list());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::option_table::OPTION_TABLE;

    fn kept(file: &str) -> String {
        std::fs::read_to_string(format!("{}/{file}", env!("CARGO_MANIFEST_DIR"))).unwrap_or_default()
    }

    /// The words of a text that was broken into lines.
    fn unwrapped(text: &str) -> String {
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn options_agree_in_docs_and_viewer() {
        assert!(
            kept("docs/options.md") == options_page(),
            "write it again: wandless options --markdown > docs/options.md"
        );
        let viewer: serde_json::Value = serde_json::from_str(&kept("web/src/data/options.json")).unwrap();
        assert_eq!(viewer, options_document(), "write it again: wandless options --json > web/src/data/options.json");
    }

    #[test]
    fn options_agree_in_help_of_both_commands() {
        use clap::CommandFactory;
        let mut cli = crate::cli::Cli::command();
        for name in ["reconstruct", "submit"] {
            let Some(command) = cli.find_subcommand_mut(name) else { continue };
            let help = unwrapped(&command.render_long_help().to_string());
            for row in OPTION_TABLE {
                let paragraph = unwrapped(&crate::pipeline::option_reference::paragraph(row));
                let is_described = help.contains(if row.flag.is_empty() { row.effect } else { &paragraph });
                let flags = crate::pipeline::option_reference::flags(row);
                let has_flags = flags.iter().all(|flag| help.contains(flag.split(' ').next().unwrap_or_default()));
                assert!(is_described && has_flags, "{name}: {}\n{help}", row.name);
            }
        }
    }

    #[cfg(feature = "service")]
    #[test]
    fn options_agree_in_openapi() {
        let document: serde_json::Value = serde_json::from_str(&crate::service::http::openapi_json()).unwrap();
        let properties = &document["components"]["schemas"]["Options"]["properties"];
        let described: Vec<&str> = properties.as_object().unwrap().keys().map(String::as_str).collect();
        assert_eq!(described.len(), OPTION_TABLE.len());
        for row in OPTION_TABLE {
            let property = &properties[row.name];
            let paragraph = crate::pipeline::option_reference::paragraph(row);
            assert_eq!(property["description"].as_str(), Some(paragraph.as_str()), "{}", row.name);
            assert_eq!(property["default"], row.default(), "{}", row.name);
            assert!(row.unit.is_empty() || property["x-unit"] == row.unit, "{}", row.name);
        }
    }
}
