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
    *DEFAULT.get_or_init(|| system_memory().map_or(u64::MAX, |bytes| bytes / 4 * 3))
}

/// Returns the memory that the machine has, or that its control group or a limit on the process
/// leaves of it, bytes; `None` where the system does not tell.
pub fn system_memory() -> Option<u64> {
    static MEMORY: OnceLock<Option<u64>> = OnceLock::new();
    *MEMORY.get_or_init(|| {
        let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        let process = read("/proc/self/limits");
        let limits = [
            field(&read("/proc/meminfo"), "MemTotal:").and_then(|kib| kib.checked_mul(1024)),
            field(&process, "Max address space"),
            field(&process, "Max data size"),
            field(&read("/sys/fs/cgroup/memory.max"), ""),
            field(&read("/sys/fs/cgroup/memory/memory.limit_in_bytes"), ""),
        ];
        let groups = control_groups(&read("/proc/self/cgroup"));
        limits.into_iter().chain(groups.iter().map(|path| field(&read(path), ""))).flatten().min()
    })
}

/// Returns the memory that is free for this process now, bytes: what the machine has available, and
/// what its control group leaves.
pub fn available_memory() -> Option<u64> {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let available = field(&read("/proc/meminfo"), "MemAvailable:").and_then(|kib| kib.checked_mul(1024));
    available.into_iter().chain(system_memory()).min()
}

/// Returns the files with the limits of the control groups that a process is in, whose
/// `/proc/self/cgroup` is given: its own and those around it.
fn control_groups(content: &str) -> Vec<String> {
    let mut paths = Vec::new();
    for line in content.lines() {
        let mut parts = line.splitn(3, ':');
        let (Some(_), Some(controllers), Some(path)) = (parts.next(), parts.next(), parts.next()) else { continue };
        let (root, file) = match controllers {
            "" => ("/sys/fs/cgroup", "memory.max"),
            list if list.split(',').any(|name| name == "memory") => ("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
            _ => continue,
        };
        let mut path = path.trim_end_matches('/');
        while !path.is_empty() && !path.split('/').any(|part| part == "..") {
            paths.push(format!("{root}{path}/{file}"));
            path = path.rfind('/').map_or("", |at| &path[..at]);
        }
    }
    paths
}

/// Returns a size for people.
pub(crate) fn mebibytes(bytes: u64) -> String {
    match bytes {
        // Less than a unit, which would be rounded to it.
        0..0x10_0000 => format!("{} KiB", bytes.div_ceil(1 << 10)),
        _ => format!("{} MiB", bytes.div_ceil(1 << 20)),
    }
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
    fn limits_of_a_control_group_and_of_those_around_it_count() {
        let of = |content| control_groups(content);
        assert_eq!(of("0::/a.slice/run-1.scope\n"), ["/sys/fs/cgroup/a.slice/run-1.scope/memory.max", "/sys/fs/cgroup/a.slice/memory.max"]);
        assert_eq!(of("5:cpu,memory:/x\n2:pids:/y\n"), ["/sys/fs/cgroup/memory/x/memory.limit_in_bytes"]);
        assert_eq!(of("0::/\n0::/../up\n\nnonsense\n"), Vec::<String>::new());
    }

    #[test]
    fn what_needs_too_much_is_refused_with_the_numbers() {
        let error = check_memory(Path::new("a.png"), u64::MAX).unwrap_err();
        assert!(error.message.starts_with("reading it takes about 17592186044416 MiB of memory, the limit is"), "{error}");
        assert!(error.remedy.is_some_and(|remedy| remedy.options().any(|option| option == "memory")));
        check_memory(Path::new("a.png"), 1 << 20).unwrap();
    }
}
