"""Robot: rosbridge link, profiles, motion lease, obstacle guard, localization, navigation."""
