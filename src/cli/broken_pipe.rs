//! The end of the program when the reader of its output has left, as in `wandless openapi | head`.

/// Makes a write to a closed pipe end the program quietly, with exit code 1. `print!` panics there, since Rust ignores the signal
/// that ends other programs.
pub(super) fn end_quietly() {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if panic.payload_as_str().is_some_and(|message| message.contains("Broken pipe")) {
            std::process::exit(1);
        }
        report(panic);
    }));
}
