//! The memory that reading one file may take: one limit for all readers.
//!
//! Sizes in a file are claims, and a compressed file of a few kilobytes can hold gigabytes. Each
//! reader estimates from the claims what it will hold at the same time, and refuses the file before
//! it allocates.

use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use luxel_core::Remedy;

use crate::IoError;

/// The limit that was set, bytes; 0: none was.
static LIMIT: AtomicU64 = AtomicU64::new(0);

/// Sets the memory that reading one file may take, bytes. By default it is three quarters of what
/// the machine, its control group or a limit on the process allows, as far as the system tells.
pub fn set_memory_limit(bytes: u64) {
    LIMIT.store(bytes.max(1), Ordering::Relaxed);
}

/// Returns the memory that reading one file may take, bytes; `u64::MAX` for no limit.
pub fn memory_limit() -> u64 {
    match LIMIT.load(Ordering::Relaxed) {
        0 => default_limit(),
        limit => limit,
    }
}

/// Returns the limit that [`set_memory_limit`] set, bytes; `None` if the default is in force.
pub fn given_memory_limit() -> Option<u64> {
    Some(LIMIT.load(Ordering::Relaxed)).filter(|limit| *limit > 0)
}

fn default_limit() -> u64 {
    static DEFAULT: OnceLock<u64> = OnceLock::new();
    *DEFAULT.get_or_init(|| {
        let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        let limits = [
            field(&read("/proc/meminfo"), "MemTotal:").and_then(|kib| kib.checked_mul(1024)),
            field(&read("/proc/self/limits"), "Max address space"),
            field(&read("/sys/fs/cgroup/memory.max"), ""),
        ];
        limits.into_iter().flatten().min().map_or(u64::MAX, |bytes| bytes / 4 * 3)
    })
}

/// Returns the number behind a name in a file of the system; `None` where there is none, or no
/// limit.
fn field(content: &str, name: &str) -> Option<u64> {
    content.lines().find_map(|line| line.strip_prefix(name))?.split_ascii_whitespace().next()?.parse().ok()
}

/// Refuses a file whose reading needs more than the limit.
pub(crate) fn check_memory(name: &Path, bytes: u64) -> Result<(), IoError> {
    let limit = memory_limit();
    if bytes <= limit {
        return Ok(());
    }
    let mebibytes = |bytes: u64| bytes.div_ceil(1 << 20);
    let message = format!("reading it takes about {} MiB of memory, the limit is {} MiB", mebibytes(bytes), mebibytes(limit));
    Err(IoError::unsupported(name, message).with_remedy(Remedy::raise("memory").or(Remedy::advice("use a smaller file"))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_of_the_system_are_read() {
        assert_eq!(field("MemFree: 3 kB\nMemTotal:   16 kB\n", "MemTotal:"), Some(16));
        let limits = "Limit   Soft Limit  Hard Limit  Units\nMax address space         4294967296           unlimited            bytes\n";
        assert_eq!(field(limits, "Max address space"), Some(4_294_967_296));
        assert_eq!(field("Max address space         unlimited            unlimited            bytes\n", "Max address space"), None);
        assert_eq!((field("max\n", ""), field("1048576\n", ""), field("", "")), (None, Some(1_048_576), None));
    }

    #[test]
    fn what_needs_too_much_is_refused_with_the_numbers() {
        let error = check_memory(Path::new("a.png"), u64::MAX).unwrap_err();
        assert!(error.message.starts_with("reading it takes about 17592186044416 MiB of memory, the limit is"), "{error}");
        assert!(error.remedy.is_some_and(|remedy| remedy.options().any(|option| option == "memory")));
        check_memory(Path::new("a.png"), 1 << 20).unwrap();
    }
}
