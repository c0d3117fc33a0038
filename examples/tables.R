# Response times and driving by condition, from exported CSV tables. No package is needed.
#
#   caris-desktop export examples/study --to csv examples-export --plain-csv
#   Rscript examples/tables.R examples-export

folder <- commandArgs(trailingOnly = TRUE)
if (length(folder) != 1) stop("usage: Rscript tables.R FOLDER")

# One table with the rows of all sessions.
read_table <- function(name) {
  files <- list.files(folder, pattern = paste0("^", name, "\\.csv$"), recursive = TRUE, full.names = TRUE)
  if (length(files) == 0) stop("no table ", name, " in ", folder)
  do.call(rbind, lapply(files, read.csv, stringsAsFactors = FALSE))
}

responses <- read_table("responses")
cat("Response times in seconds, by condition\n")
print(aggregate(gap_s ~ condition, data = responses, FUN = summary))

odometry <- read_table("odometry")
odometry$moving <- abs(odometry$twist_forward_mps) > 0.01
cat("\nShare of odometry rows in which the robot moved forwards or backwards\n")
print(aggregate(moving ~ condition, data = odometry, FUN = mean))

stopifnot(setequal(responses$condition, c("A", "B")), any(odometry$moving))
