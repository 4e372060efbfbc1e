# The pipeline of one workspace: `make` labels every drive and detects, `make autolabel` labels, `make STAGE` makes one stage.
# An experiment: cp -r stages stages2, change a value, make STAGES=stages2 OUT=out2

UPVL_COMMAND ?= upvl
STAGES ?= stages
OUT ?= out
UPVL = $(UPVL_COMMAND) --stages $(STAGES) --out $(OUT)

.DEFAULT_GOAL := pipeline
.PHONY: pipeline FORCE

# Goals that need no shard need no plan.
NO_PLAN += clean
ifneq ($(filter-out $(NO_PLAN),$(or $(MAKECMDGOALS),pipeline)),)
include $(OUT)/rules.mk
endif

# Asked for each time, but written only where it would differ: then nothing is made again.
$(OUT)/rules.mk: FORCE
	@$(UPVL) plan

pipeline: $(LABELLING) detect
	@echo "pictures:"
	@$(UPVL) draw
	@$(UPVL) query car --on labels || true  # drives without pictures have no features to ask: it says so
	@$(UPVL) summary

.PHONY: clean
clean:
	rm -rf $(OUT)
