//! Environment variables that libraries expect.
//!
//! Mesa's Vulkan layer for the choice of a GPU asks for Wayland's default display whenever an
//! instance is made, and libwayland prints an error for each attempt where `XDG_RUNTIME_DIR` is not
//! set: on servers and in containers. Luxel opens no window through Vulkan. A path that cannot
//! exist in place of the missing variable ends the attempt without a word.

/// A folder that no system has: it would be below a file.
#[cfg(target_os = "linux")]
const NO_FOLDER: &str = "/dev/null";

/// Names a folder for `XDG_RUNTIME_DIR` where none is set. Call it before any thread starts.
#[cfg(target_os = "linux")]
#[expect(unsafe_code, reason = "the standard library has no safe way to set a variable for libraries in C")]
pub(crate) fn prepare() {
    const NAME: &str = "XDG_RUNTIME_DIR";
    if std::env::var_os(NAME).is_none_or(|folder| !std::path::Path::new(&folder).is_absolute()) {
        // SAFETY: no other thread can read the environment meanwhile, as none has been started.
        unsafe { std::env::set_var(NAME, NO_FOLDER) };
    }
}

/// Does nothing: only Linux has that layer.
#[cfg(not(target_os = "linux"))]
pub(crate) fn prepare() {}
