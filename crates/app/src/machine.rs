//! Facts about this machine that need no privileges to read.

use luxel::processor_name;

use crate::text;

/// Returns names and values for people.
pub fn facts(cores: usize) -> Vec<(&'static str, String)> {
    let mut facts = Vec::new();
    if let Some(model) = processor_name() {
        facts.push(("processor", model));
    }
    facts.push(("cores", format!("{cores} for this program")));
    if let Some(bytes) = memory_bytes(&std::fs::read_to_string("/proc/meminfo").unwrap_or_default()) {
        facts.push(("memory", text::bytes(bytes)));
    }
    facts.push(("system", format!("{} on {}", std::env::consts::OS, std::env::consts::ARCH)));
    facts
}

fn memory_bytes(meminfo: &str) -> Option<u64> {
    let rest = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    rest.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_are_read_where_the_system_tells_them() {
        assert_eq!((memory_bytes("MemTotal:   16 kB\n"), memory_bytes("MemFree: 3 kB\n")), (Some(16384), None));
        assert!(facts(3).iter().any(|(name, value)| *name == "cores" && value.starts_with('3')));
    }
}
